"""Readers and writers: recordings, trajectories, videos, logs of robots, URDF, MuJoCo models and artifacts.

`read` opens any of them (`read_recording`, `read_trajectory`); `sources` finds what an argument names.
Only this package touches user files.
"""
