"""How well a recording determines a law: intervals of its modes and equilibria.

Residuals are coloured and the law is not exact, so the curvature of the misfit alone would promise too much.
Scores of blocks of consecutive windows vary as much as the data make them (a sandwich covariance); laws are
drawn by weighing the blocks at random.

Source: White 1982, DOI 10.2307/1912526 (misspecified likelihoods); Kline and Santos 2012, DOI
10.1515/2156-6674.1003 (random weights of scores).
"""

from collections.abc import Sequence
from contextlib import suppress

import numpy as np
import torch
from jaxtyping import Float, Float64
from scipy.optimize import linear_sum_assignment
from scipy.stats import norm, t
from torch import Tensor

from lagsplat.stage2.lagrangian import LinearizedModes, linearize_modes
from lagsplat.stage2.likelihood.multiple_shooting import WindowScores
from lagsplat.stage2.likelihood.parameter_vector import ParameterVector

COVERAGE = 0.9  # of every interval
TAILS = (0.5 * (1.0 - COVERAGE), 0.5 * (1.0 + COVERAGE))
# The numbers below were set by hand.
STEP = 0.002  # of the way to a drawn law, which may be far where a recording is short
LARGEST_LOG = 7.0  # of a ratio: a thousandfold is unknown
BLOCKS = 10  # of windows, at least three each: neighbours share what is coupled
DRAWS = 100


def draw_parameters(
    scores: WindowScores, theta: Float64[np.ndarray, " p"], *, seed: int
) -> Float64[np.ndarray, "n p"]:
    """Draw parameters about ``theta``, as widely as blocks of windows disagree about them.

    Deviations are stretched so that normal quantiles of the draws are those of Student's t with as many
    degrees of freedom as there are blocks less one. What the windows do not determine varies as its prior.

    Args:
        scores: of the windows at ``theta``, from `MultipleShooting.score_windows`.
        theta: the fitted parameters.
        seed: of the random weights.

    Raises:
        ValueError: fewer than two windows.
    """
    n_blocks = min(BLOCKS, len(scores.scores), max(2, len(scores.scores) // 3))
    if n_blocks < 2:
        raise ValueError(f"{len(scores.scores)} window: a spread needs two at least; record longer clips")
    parts = np.array_split(np.arange(len(scores.scores)), n_blocks)
    left_out = [
        np.linalg.solve(scores.information - scores.each[part].sum(0), scores.scores[part].sum(0))
        for part in parts
    ]
    deviations = np.sqrt((n_blocks - 1) / n_blocks) * (left_out - np.mean(left_out, axis=0))
    stretch = t.ppf(TAILS[1], n_blocks - 1) / norm.ppf(TAILS[1])
    rng = np.random.default_rng(seed)
    draws = stretch * rng.standard_normal((DRAWS, n_blocks)) @ deviations
    prior = rng.standard_normal((DRAWS, len(theta))) * np.sqrt(scores.prior)
    return theta + draws + np.linalg.solve(scores.information, prior.T).T


def draw_modes(
    parameters: ParameterVector, draws: Float64[np.ndarray, "n p"], u: Float[Tensor, " n_u"]
) -> list[LinearizedModes]:
    """Modes and equilibria under a constant input ``u`` of laws a `STEP` of the way to the drawn ones.

    So near, modes and equilibria are still those of the law, moved: a law that is drawn far from a recording
    that hardly determines it may be no mechanism at all. The law is left as it was.
    """
    theta, drawn = parameters.read(), []
    for each in draws:
        parameters.write(theta + STEP * (torch.from_numpy(each) - theta))
        with suppress(ValueError, RuntimeError, np.linalg.LinAlgError):
            drawn.append(linearize_modes(parameters.lagrangian, u))
    parameters.write(theta)
    return drawn


def measure_intervals(
    modes: LinearizedModes, drawn: Sequence[LinearizedModes]
) -> Float64[np.ndarray, "m 2 2"]:
    """Ends [Hz, 1/s] of the intervals of frequency and decay of each mode, from `draw_modes`; empty for none.

    They are those of logarithms, by the delta method.
    """
    if not drawn:
        return np.zeros((0, 2, 2))
    ours = np.stack([modes.frequency_hz, modes.decay_per_s], axis=1)
    pairs = np.stack([match_modes(modes, other) for other in drawn])
    with np.errstate(all="ignore"):
        moved = np.log(pairs / ours) / STEP
        spread = np.nanquantile(np.where(np.isfinite(moved), moved, np.nan), TAILS, axis=0)
        return np.moveaxis(ours * np.exp(np.clip(spread, -LARGEST_LOG, LARGEST_LOG)), 0, 2)


def match_modes(modes: LinearizedModes, other: LinearizedModes) -> Float64[np.ndarray, "m 2"]:
    """Frequency [Hz] and decay [1/s] of the mode of ``other`` nearest to each of ``modes``.

    A mode that ``other`` lacks has frequency zero there and no decay.
    """
    ours, theirs = (
        np.array(each.frequency_hz) * 2j * np.pi - np.array(each.decay_per_s) for each in (modes, other)
    )
    pairs = np.tile([0.0, np.nan], (len(ours), 1))
    apart = np.abs(ours[:, None] - theirs) / np.maximum(np.abs(ours)[:, None] + np.abs(theirs), 1e-12)
    rows, columns = linear_sum_assignment(np.nan_to_num(apart, nan=1.0))
    pairs[rows] = np.stack([theirs.imag / (2.0 * np.pi), -theirs.real], axis=1)[columns]
    return pairs
