"""Cameras and the views they give."""
