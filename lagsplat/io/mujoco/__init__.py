"""Model files of MuJoCo: MJCF, URDF, and parameters that its identification toolbox fitted."""
