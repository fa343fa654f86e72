"""Files written whole or not at all: artifacts, checkpoints, downloads, PLY clouds, JSON and CSV."""
