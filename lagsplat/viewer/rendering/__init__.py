"""Frames, outlines and arrows of the interactive simulation, without a browser."""
