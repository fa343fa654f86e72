"""Recordings: frames, times and inputs of one mechanism."""
