"""The live view in a browser: scene, controls, drags, plots and access control, on viser.

`server` starts it (`ViewerServer`); `scene`, `canvas` and `controls` are its parts,
and `session_export` writes a session as MCAP, MP4 or GIF.
"""
