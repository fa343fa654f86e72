"""Masses that differ from those of the simulation, and parts that it lacks; one a file."""
