"""The CPU rasteriser, compiled by Numba: eight or sixteen pixels at a time, in parallel over frames."""
