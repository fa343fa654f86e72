"""The catalogue of unmodelled effects, one file each."""
