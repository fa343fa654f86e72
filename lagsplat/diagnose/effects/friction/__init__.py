"""Friction and damping; one a file."""
