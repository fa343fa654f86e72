"""Where cameras stand around a scene that only one camera has filmed."""

import numpy as np

from lagsplat.views.camera import Camera, orbit
from lagsplat.views.config import ArrangementConfig
from lagsplat.views.space import Space

BETWEEN = 0.55
"""Of the extents: the ellipse on which held-out cameras stand, off the rows and columns of the others."""
START = 0.4
"""[rad], of the first of them."""


def arrange(space: Space, config: ArrangementConfig) -> tuple[list[Camera], list[str], list[bool]]:
    """Cameras on a grid of yaws and pitches about the pivot, then the held-out ones between them.

    All are the reference camera moved on a sphere about the pivot of ``space``, which they keep where it is
    in the picture. Returned with a name and whether it is held out for each.
    """
    yaws = _ticks(config.yaw_deg, config.columns)
    pitches = _ticks(config.pitch_deg, config.rows)
    angles = [(yaw, pitch, False) for pitch in pitches for yaw in yaws]
    turns = START + 2 * np.pi * np.arange(config.held_out) / max(config.held_out, 1)
    angles += [
        (BETWEEN * config.yaw_deg * np.cos(turn), BETWEEN * config.pitch_deg * np.sin(turn), True)
        for turn in turns
    ]
    cameras = [orbit(space.reference, space.depth, yaw_deg=yaw, pitch_deg=pitch) for yaw, pitch, _ in angles]
    names = [f"yaw {yaw:+.1f} pitch {pitch:+.1f}" for yaw, pitch, _ in angles]
    return cameras, names, [held_out for *_, held_out in angles]


def _ticks(extent: float, count: int) -> list[float]:
    return np.linspace(-extent, extent, count).tolist() if count > 1 else [0.0]
