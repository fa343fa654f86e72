"""How the work of the residual grows with amplitude: the exponent tells one law of friction from another.

Per cycle, viscous friction takes work as the square of the amplitude, Coulomb's as the amplitude, a quadratic
drag as its cube. The sign tells whether the sim dissipates too little (positive) or too much.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.residual.latent_force import Smoothed

EXPONENTS = np.linspace(-1.0, 5.0, 241)
DRAWS = 499
COVERAGE = 0.95
FEWEST = 6
SPREAD = 1.5  # the least ratio of a large to a small amplitude
SMALLEST = 0.05  # of the largest amplitude,
CLEAR = 10.0  # and times the measurement noise: smaller cycles are mostly the smoother's own
UNEVEN = 0.1  # of a cycle's own work: how far a law may be off


@dataclass(frozen=True)
class Cycles:
    """One coordinate's cycles: ``amplitude`` (n,), ``work`` (n,) taken by the residual over the inertia at
    rest and its standard deviation ``std`` (n,), ``frequency_hz`` (n,)."""

    amplitude: np.ndarray
    work: np.ndarray
    std: np.ndarray
    frequency_hz: np.ndarray


@dataclass(frozen=True)
class Dissipation:
    """Exponent of dissipated work against amplitude with its 95 % interval; ``gained`` where the residual
    brings energy in instead. ``cycles`` it rests on."""

    exponent: float
    low: float
    high: float
    gained: bool
    cycles: int


def cycles(smoothed: Sequence[Smoothed], coordinate: int) -> Cycles:
    """Cycles between rising zero crossings of velocity, inside clips, that stand clear of noise and rest.

    A cycle's work is that of the residual against the motion; its uncertainty takes the residual's errors for
    correlated over the force's length scale.
    """
    found = []
    for one in smoothed:
        for start, stop in one.motion.segments:
            v = one.v[start:stop, coordinate]
            turns = start + np.flatnonzero((v[:-1] <= 0.0) & (v[1:] > 0.0))
            for a, b in pairwise(turns):
                found.append(_cycle(one, coordinate, slice(a, b + 1)))
    rows = np.array(found).reshape(-1, 4)
    least = max(SMALLEST * rows[:, 0].max(initial=0.0), CLEAR * float(smoothed[0].noise[coordinate]))
    return Cycles(*rows[rows[:, 0] >= least].T)


def dissipation(found: Cycles, *, seed: int = 0) -> Dissipation | None:
    """Fit ``work = c amplitude^p``; None where six cycles, a ratio of 1.5 between amplitudes, or any clear
    work are missing.

    Weighted least squares in the work itself, since its logarithm would drop every cycle that noise made
    negative; the interval is over resampled cycles.
    """
    if len(found.work) < FEWEST:
        return None
    low, high = np.quantile(found.amplitude, [0.1, 0.9])
    total, uncertain = found.work.sum(), np.sqrt(np.sum(found.std**2))
    if high < SPREAD * low or abs(total) <= 2.0 * uncertain:
        return None
    exponent = _exponent(found, np.arange(len(found.work))[None])[0]
    draws = np.random.default_rng(seed).integers(0, len(found.work), (DRAWS, len(found.work)))
    tail = 0.5 * (1.0 - COVERAGE)
    bounds = np.quantile(_exponent(found, draws), [tail, 1.0 - tail])
    return Dissipation(
        float(exponent), float(bounds[0]), float(bounds[1]), bool(total < 0.0), len(found.work)
    )


def _cycle(one: Smoothed, i: int, at: slice) -> tuple[float, float, float, float]:
    time_s, q, v = one.motion.time_s[at], one.q[at, i], one.v[at, i]
    seconds = time_s[-1] - time_s[0]
    work = -np.trapezoid(one.residual[at, i] * v, time_s)
    correlated = min(one.length_s, seconds)
    std = np.sqrt(np.mean(one.std[at, i] ** 2 * v**2) * correlated * seconds)
    return float(0.5 * np.ptp(q)), float(work), float(std), float(1.0 / seconds)


def _exponent(found: Cycles, draws: np.ndarray) -> Float64[np.ndarray, " D"]:
    """Best exponent of each row of drawn cycles, on a grid."""
    relative = found.amplitude / np.median(found.amplitude)
    powers = relative[:, None] ** EXPONENTS
    # A law right to a tenth must not be bent by the few largest cycles, whose noise is the least.
    weight = 1.0 / np.maximum(found.std**2 + (UNEVEN * found.work) ** 2, 1e-300)
    chosen = np.stack([np.bincount(row, minlength=len(weight)) for row in draws]) * weight
    cross = (chosen * found.work) @ powers
    return EXPONENTS[np.argmax(cross**2 / (chosen @ powers**2), axis=1)]
