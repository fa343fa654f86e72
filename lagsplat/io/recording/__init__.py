"""Recordings: frames, times and inputs of one mechanism.

`recording` holds one (`Recording`), `alignment` interpolates logs to the frames (`align_log`), and
`segments` cuts at gaps and splits training from held-out frames.
"""
