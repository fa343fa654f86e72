"""Rendered frames of the simulated systems."""
