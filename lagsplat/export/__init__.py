"""Fitted runs in other programs' formats.

`mcap` writes a rollout as a log for Foxglove, `ply` writes Gaussians as a 3DGS point cloud.
"""
