"""Drawn frames of the simulated systems.

`arm` paints the pneumatic arms, `bodies` rigid bodies before a background, and `textures` what they look
like.
"""
