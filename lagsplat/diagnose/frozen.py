"""Frames that show again what an earlier one showed: the motion stands still, then catches up in one step."""

import numpy as np
from jaxtyping import Bool, Float64, Int64
from numpy.polynomial import Polynomial

STILL, JUMP = 3.0, 6.0
"""Steps, in those that noise makes, up to which a picture is the same, and from which it has jumped."""
LONGEST = 200
"""Samples that a picture may stand still."""
LAG, USUAL = 3, 0.95
"""Samples over which the motion bends, and the quantile that tells how sharply it mostly does."""
BESIDE, DEGREE = 5, 3
"""Samples to either side, and the degree of the polynomial that is laid through them."""
CLEAR = 5.0
"""Steps of noise by which what stands still must miss that polynomial somewhere."""
SHARPER = 1.3
"""How much more sharply than it mostly does the motion may have bent meanwhile."""
SMOOTH = 0.1
"""Of that, what the samples beside may miss it by, or a step of noise."""
OFTEN = 5
"""Repeats beyond doubt from which on what stands still for `SHORTEST` samples or up to a jump is one."""
SHORTEST = 4


def frozen(
    q: Float64[np.ndarray, "N d"], clips: Int64[np.ndarray, "C 2"], sigma: Float64[np.ndarray, " d"]
) -> Bool[np.ndarray, " N"]:
    """Which samples repeat an earlier one.

    A mechanism that sticks moves on from where it stood; it does not appear where it would have been by now.
    """
    late = np.zeros(len(q), dtype=bool)
    step = np.sqrt(2.0) * np.maximum(sigma, 1e-300)
    for start, stop in clips:
        z = q[start:stop] / step
        stood = _before_jumps(z)
        sure = [run for run in stood if _misses(z, *run)]
        # samples beside a repeat may be repeats, too, and a motion that turns catches up without a jump
        for first, end in [*stood, *_standstills(z)] if len(sure) >= OFTEN else sure:
            late[start + first + 1 : start + end] = True
    return late


def _before_jumps(z: np.ndarray) -> list[tuple[int, int]]:
    """First sample of each picture that stands still, and the sample that has jumped away from it."""
    moved = np.abs(np.diff(z, axis=0)).max(axis=1)
    found = []
    for jump in map(int, np.flatnonzero((moved[1:] > JUMP) & (moved[:-1] <= STILL)) + 2):
        back = max(0, jump - LONGEST)
        stays = (np.abs(z[back:jump] - z[jump - 1]) <= STILL).all(axis=1)
        first = back if stays.all() else back + int(np.flatnonzero(~stays)[-1]) + 1
        if jump - first >= 2:
            found.append((first, jump))
    return found


def _standstills(z: np.ndarray) -> list[tuple[int, int]]:
    """First sample and end of all that stays within noise of where it begins, one after the other."""
    found, first = [], 0
    while first < len(z):
        stays = (np.abs(z[first : first + LONGEST] - z[first]) <= STILL).all(axis=1)
        end = first + (len(stays) if stays.all() else int(np.argmin(stays)))
        if end - first >= SHORTEST:
            found.append((first, end))
        first = end
    return found


def _misses(z: np.ndarray, first: int, jump: int) -> bool:
    """Whether the motion before and after goes on smoothly past what stands still from ``first`` on."""
    if first + 1 < BESIDE or jump + BESIDE > len(z):
        return False
    i = int(np.argmax(np.abs(z[jump] - z[jump - 1])))
    beside = np.r_[first + 1 - BESIDE : first + 1, jump : jump + BESIDE]
    path = Polynomial.fit(beside, z[beside, i], DEGREE)
    late = np.arange(first + 1, jump)
    missed = float(np.abs(z[late, i] - path(late)).max())
    left = float(np.sqrt(np.mean((z[beside, i] - path(beside)) ** 2)))
    bent = float(np.abs(path.deriv(2)(np.arange(first, jump + 1))).max())
    usual = np.abs(z[2 * LAG :, i] - 2.0 * z[LAG:-LAG, i] + z[: -2 * LAG, i]) / LAG**2
    allowed = SHARPER * float(np.quantile(usual, USUAL))
    return missed > CLEAR and left < max(1.0, SMOOTH * missed) and bent < allowed
