"""Readers and writers: recordings, trajectories, videos, MCAP logs and artifacts.

`read` opens any of them (`read_recording`, `read_trajectory`). This room is the only code of the package
that touches files of users.
"""
