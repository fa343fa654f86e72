"""Cameras, calibrated rigs and the views they give of a scene.

`camera` has the pinhole `Camera` and arrangements of cameras, `rig` reads a calibrated rig (`read_rig`), and
`novel` holds the views that supervise stage 1 (`NovelViews`).
"""
