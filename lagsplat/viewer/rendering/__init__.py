"""Frames and overlays of the interactive simulation, without a browser.

`renderer` draws the object (`FrameRenderer`), `scene_frame` relates pixels, space and the scene of the page,
and `overlays` traces outlines and acceleration arrows.
"""
