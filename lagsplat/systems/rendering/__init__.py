"""Rendered frames of the simulated systems.

`painting` renders the pneumatic arms and rigid bodies before a background; `textures` holds the sprites.
"""
