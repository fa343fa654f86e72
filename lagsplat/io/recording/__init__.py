"""Recordings: frames, times and inputs of one mechanism.

`recording` holds one (`Recording`), `alignment` brings a log and frames to one clock (`align_log`), and
`segments` cuts at gaps and splits training from held-out clips.
"""
