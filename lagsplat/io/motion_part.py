"""The beginning of a motion, cut at clips."""

import numpy as np

from lagsplat.io.motion import Motion


def leading(motion: Motion, length_s: float) -> Motion:
    """The first clips of a motion, as many as last ``length_s`` [s] together, the last of them cut."""
    pieces: list[tuple[int, int]] = []
    left = length_s
    for start, stop in motion.segments:
        own = motion.time_s[start:stop] - motion.time_s[start]
        end = start + int(np.searchsorted(own, left, side="right"))
        if end - start > 1 or not pieces:
            pieces.append((start, end))
        left -= float(own[end - start - 1])
        if left <= 0.0:
            break
    return motion.pieces(pieces)
