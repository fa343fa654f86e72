"""The CPU rasteriser, compiled by Numba: eight pixels at a time, in parallel over frames."""
