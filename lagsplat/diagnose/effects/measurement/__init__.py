"""Effects of sensor and clock, which leave the mechanism as it is; one a file.

Their words hold for any sensor: an encoder and its clock as well as a camera.
"""
