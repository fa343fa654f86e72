"""Places where a film jumps: a cut, frames that are missing, or a loop back to an earlier moment."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float32, Float64

RATIO = 5.0  # a jump changes the picture this many times as much as the frames around it...
SHARE = 0.25  # ...and at least this share of the change between two frames taken anywhere
AROUND = 2  # frames on either side
SLIGHT = 0.02  # share of that change below which a film stands still
NOISES, LEVELS = 5.0, 2.0  # medians of the change, and levels of 255, that a pixel may change by noise


@dataclass(frozen=True)
class Cut:
    """A jump between two frames: the time of the later one [s], and how many times the change around it."""

    time_s: float
    ratio: float


def find_cuts(grey: Float32[np.ndarray, "T h w"], time_s: Float64[np.ndarray, " T"]) -> tuple[Cut, ...]:
    """Jumps that the running motion does not explain; ``grey`` should be free of flicker.

    A single bright or broken frame is none: the film goes on where it was. A small object that jumps while it
    moves by a third of its own size a frame changes hardly more pixels than before, and goes unseen.
    """
    half = len(grey) // 2
    usual_change = np.median([np.median(np.abs(later - earlier)) for earlier, later in pairwise(grey)])
    limit = NOISES * float(usual_change) + LEVELS
    change = np.array([_excess(later - earlier, limit) for earlier, later in pairwise(grey)])
    anywhere = float(np.median([_excess(grey[i + half] - grey[i], limit) for i in range(half)]))
    found = []
    for i, now in enumerate(change):
        around = np.concatenate([change[max(0, i - AROUND) : i], change[i + 1 : i + 1 + AROUND]])
        usual = max(float(around.max()), SLIGHT * anywhere, 1e-6)
        if now > RATIO * usual and now > SHARE * anywhere:
            found.append(Cut(time_s=float(time_s[i + 1]), ratio=float(now / usual)))
    return tuple(found)


def _excess(difference: Float32[np.ndarray, "h w"], limit: float) -> float:
    """Mean change beyond ``limit``, which noise and compression make of a picture that stands still."""
    return float(np.maximum(np.abs(difference) - limit, 0.0).mean(dtype=np.float64))
