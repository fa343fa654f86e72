"""Files written whole or not at all: artifacts, checkpoints, downloads, PLY clouds, JSON and CSV.

`artifact` saves tensors with a header (`save_artifact`, `load_artifact`), `atomic` replaces files in one
step, `download` resumes and checks checksums.
"""
