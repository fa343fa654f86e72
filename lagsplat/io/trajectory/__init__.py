"""Trajectories: coordinates and inputs against time, from CSV, Parquet, NPZ or MCAP.

`trajectory` holds one (`Trajectory`, `read_trajectory_file`), `tables` reads tables and names their columns,
and `inputs` reads the inputs that drive a simulation.
"""
