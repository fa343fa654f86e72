"""The live view in a browser: scene, controls, drags, plots and access control, on viser.

`server` starts it (`ViewerServer`, `ViewerContent`); `scene`, `canvas`, `controls` and `drag` are its parts,
and `session_export` writes a session as MCAP, MP4 or GIF.
"""
