"""Places where a film jumps: a cut, frames that are missing, or a loop back to an earlier moment."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float32, Float64

RATIO = 5.0  # a jump changes the picture this many times as much as the frames around it...
SHARE = 0.25  # ...and at least this share of the change between two frames taken anywhere
AROUND = 2  # frames on either side


@dataclass(frozen=True)
class Cut:
    """A jump between two frames: the time of the later one [s], and how many times the change around it."""

    time_s: float
    ratio: float


def find_cuts(grey: Float32[np.ndarray, "T h w"], time_s: Float64[np.ndarray, " T"]) -> tuple[Cut, ...]:
    """Jumps that the running motion does not explain; ``grey`` should be free of flicker.

    A single bright or broken frame is none: the film goes on where it was.
    """
    change = np.array([np.abs(b - a).mean(dtype=np.float64) for a, b in pairwise(grey)])
    half = len(grey) // 2
    anywhere = np.median([np.abs(grey[i + half] - grey[i]).mean(dtype=np.float64) for i in range(half)])
    found = []
    for i, now in enumerate(change):
        around = np.concatenate([change[max(0, i - AROUND) : i], change[i + 1 : i + 1 + AROUND]])
        usual = max(float(around.max()), 1e-6)
        if now > RATIO * usual and now > SHARE * anywhere:
            found.append(Cut(time_s=float(time_s[i + 1]), ratio=float(now / usual)))
    return tuple(found)
