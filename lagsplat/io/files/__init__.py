"""Files of every kind that stay whole: artifacts, checkpoints, downloads, PLY clouds, JSON and CSV.

`artifact` keeps tensors with a header (`save_artifact`, `load_artifact`), `atomic` replaces files in one
step, `download` fetches with a checksum and resumes.
"""
