"""Cameras, calibrated rigs and the views they give of a scene."""
