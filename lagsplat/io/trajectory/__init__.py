"""Trajectories: coordinates and inputs against time, from CSV, Parquet, NPZ, MATLAB or MCAP."""
