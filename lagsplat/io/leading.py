"""Frames that a recorder writes several times before its clock runs."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import UInt8

LOOKED_AT = 6  # frames
SHARE = 1 / 50  # of the median difference, below which two frames are one


def duplicates_at_start(frames: Sequence[UInt8[np.ndarray, "H W 3"]]) -> int:
    """How many leading frames only repeat the one after them.

    Two neighbours are one frame if their mean squared difference is below a fiftieth of the median over the
    first six frames.
    """
    first = [np.asarray(frame, dtype=np.float32) for frame in frames[:LOOKED_AT]]
    apart = [float(((b - a) ** 2).mean()) for a, b in pairwise(first)]
    if not apart:
        return 0
    new = [difference >= SHARE * float(np.median(apart)) for difference in apart]
    return new.index(True) if True in new else 0
