"""How well a recording determines a law: intervals of its modes and equilibria.

Residuals are coloured and the law is not exact, so the curvature of the misfit alone would promise too much.
Blocks of a recording, left out in turn, show how much the parameters vary (a jackknife, which estimates the
sandwich covariance). Ten blocks estimate a variance badly: where it comes out smaller than the inverse of the
curvature, that is taken.

Source: White 1982, DOI 10.2307/1912526 (misspecified likelihoods); Kunsch 1989, DOI 10.1214/aos/1176347265
(jackknife by blocks).
"""

from collections.abc import Sequence
from contextlib import suppress

import numpy as np
import torch
from jaxtyping import Float, Float64
from scipy.optimize import linear_sum_assignment
from scipy.special import ndtri, stdtrit
from torch import Tensor

from lagsplat.stage2.equilibrium import (
    LinearizedModes,
    NoEquilibriumError,
    find_equilibrium,
    linearize_modes,
)
from lagsplat.stage2.likelihood.multiple_shooting import WindowScores
from lagsplat.stage2.likelihood.parameter_vector import ParameterVector

COVERAGE = 0.9  # of every interval
TAILS = (0.5 * (1.0 - COVERAGE), 0.5 * (1.0 + COVERAGE))
# The numbers below were set by hand.
STEP = 0.002  # of the way to a drawn law, which may be far where a recording is short
LARGEST_LOG = 7.0  # of a ratio: a thousandfold is unknown
BLOCKS = 10  # of a recording; of windows at least three each: neighbours share what is coupled
DRAWS = 100


def leave_out_windows(scores: WindowScores) -> Float64[np.ndarray, "n p"]:
    """Changes of the parameters, to first order, where one of `BLOCKS` blocks of windows is left out.

    Args:
        scores: of the windows at the fitted parameters, from `MultipleShooting.score_windows`.

    Raises:
        ValueError: fewer than two windows.
        numpy.linalg.LinAlgError: a parameter is not determined.
    """
    n_blocks = min(BLOCKS, len(scores.scores), max(2, len(scores.scores) // 3))
    if n_blocks < 2:
        raise ValueError(f"{len(scores.scores)} window: a spread needs two at least; record longer clips")
    moved = []
    for part in np.array_split(np.arange(len(scores.scores)), n_blocks):
        kept = scores.information - scores.each[part].sum(0)
        moved.append(np.linalg.solve(kept, scores.scores[part].sum(0)))
    return np.stack(moved)


def draw_parameters(
    theta: Float64[np.ndarray, " p"],
    left_out: Float64[np.ndarray, "n p"],
    *,
    information: Float64[np.ndarray, "p p"] | None = None,
    seed: int,
) -> Float64[np.ndarray, "m p"]:
    """Draw parameters about ``theta``, as widely as they vary where blocks of a recording are left out.

    Deviations are stretched so that normal quantiles of the draws are those of Student's t with as many
    degrees of freedom as there are blocks less one.

    Args:
        theta: the fitted parameters.
        left_out: the parameters of fits without one of ``n`` blocks each.
        information: curvature of the posterior at ``theta``, if known. In no direction do the draws vary less
            than its inverse says, so that what a recording does not determine varies as its prior.
        seed: of the draws.

    Raises:
        numpy.linalg.LinAlgError: a parameter is not determined.
    """
    n_blocks, rng = len(left_out), np.random.default_rng(seed)
    stretch = stdtrit(n_blocks - 1, TAILS[1]) / ndtri(TAILS[1])
    deviations = stretch * np.sqrt((n_blocks - 1) / n_blocks) * (left_out - left_out.mean(axis=0))
    if information is None:
        return theta + rng.standard_normal((DRAWS, n_blocks)) @ deviations
    factor = np.linalg.cholesky(information)
    # in coordinates in which the curvature is one
    _, sizes, directions = np.linalg.svd(deviations @ factor)
    deviation = np.maximum(np.pad(sizes, (0, len(theta) - len(sizes))), 1.0)
    drawn = rng.standard_normal((DRAWS, len(theta))) * deviation
    return theta + np.linalg.solve(factor.T, (drawn @ directions).T).T


def draw_modes(
    parameters: ParameterVector, draws: Float64[np.ndarray, "n p"], u: Float[Tensor, " n_u"]
) -> list[LinearizedModes]:
    """Modes and equilibria under a constant input ``u`` of laws a `STEP` of the way to the drawn ones.

    So near, modes and equilibria are still those of the law, moved: a law that is drawn far from a recording
    that hardly determines it may be no mechanism at all. The law is left as it was; if it has no equilibrium,
    there are no modes.
    """
    theta, drawn = parameters.read(), []
    try:
        near = find_equilibrium(parameters.lagrangian, u)
    except NoEquilibriumError:
        return []
    for each in draws:
        parameters.write(theta + STEP * (torch.from_numpy(each) - theta))
        with suppress(ValueError, RuntimeError, np.linalg.LinAlgError):
            drawn.append(linearize_modes(parameters.lagrangian, u, near))
    parameters.write(theta)
    return drawn


def measure_intervals(
    modes: LinearizedModes, drawn: Sequence[LinearizedModes]
) -> Float64[np.ndarray, "m 2 2"]:
    """Ends [Hz, 1/s] of the intervals of frequency and decay of each mode, from `draw_modes`; empty for none.

    They are those of logarithms, by the delta method, and as far below a value as above. What more than one
    drawn law in ten lacks is unknown. NaN for a frequency or decay of zero.
    """
    if not drawn:
        return np.zeros((0, 2, 2))
    ours = np.stack([modes.frequency_hz, modes.decay_per_s], axis=1)
    pairs = np.stack([match_modes(modes, other) for other in drawn])
    with np.errstate(all="ignore"):
        moved = np.nan_to_num(np.abs(np.log(pairs / ours)) / STEP, nan=np.inf)
        half = np.quantile(moved, COVERAGE, axis=0, method="higher").clip(max=LARGEST_LOG)
        known = np.where(ours > 0.0, ours, np.nan)
        return np.stack([known * np.exp(-half), known * np.exp(half)], axis=2)


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
