"""Practical identifiability: which effects these data could separate."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.core.config import IDENTIFIABILITY
from lagsplat.diagnose.effects.base import SampleEffect
from lagsplat.diagnose.estimation.multiple_shooting import eliminate_starts
from lagsplat.diagnose.inference.evidence import HypothesisFit
from lagsplat.diagnose.inference.problem import EstimationProblem, make_joint_prior


@dataclass(frozen=True)
class Separability:
    """Expected log Bayes factor (n, n) of the effect of a row over that of a column [nat]."""

    names: tuple[str, ...]
    nats: Float64[np.ndarray, "n n"]


def compute_separability(
    problem: EstimationProblem, found: Sequence[HypothesisFit], *, noise_inflation: float
) -> Separability | None:
    """Compare the best fits of single effects; None if fewer than two change the motion.

    The change by one effect is regressed on the derivatives by another one, by the nuisance parameters and by
    the initial states. Half of the square that remains, over ``noise_inflation``, is the expected log Bayes
    factor.
    """
    best: dict[str, HypothesisFit] = {}
    for hypothesis in found:
        # an effect that changes nothing, or overflows, has no derivatives to regress on
        lone = len(hypothesis.effects) == 1 and not isinstance(hypothesis.effects[0].effect, SampleEffect)
        if (
            lone
            and np.isfinite(hypothesis.fit.slopes).all()
            and np.isfinite(hypothesis.fit.start_slopes).all()
        ):
            best.setdefault(hypothesis.effects[0].effect.name, hypothesis)
    fits = list(best.values())[: IDENTIFIABILITY.max_effects]
    if len(fits) < 2:
        return None
    marks = [_effect_signature(problem, hypothesis) for hypothesis in fits]
    nats = np.array([[_unexplained_square(problem, mark, other) for other in fits] for mark in marks]) / (
        2.0 * noise_inflation
    )
    return Separability(tuple(hypothesis.effects[0].effect.name for hypothesis in fits), nats)


def _effect_signature(problem: EstimationProblem, hypothesis: HypothesisFit) -> Float64[np.ndarray, "W L d"]:
    """Change of the motion by the effect alone, over the noise: to first order in its amplitudes.

    Of an effect without amplitudes, as a delay, it is the full change.
    """
    amplitudes = hypothesis.effects[0].effect.amplitudes
    if amplitudes:
        change = hypothesis.fit.slopes[..., :amplitudes] @ hypothesis.fit.x[:amplitudes]
        return change.reshape(problem.data.y.shape)
    x, starts = hypothesis.fit.x[None], hypothesis.fit.starts[None]
    with_it = problem.predict(hypothesis.effects)(x, starts)[0]
    without = problem.predict(())(x[:, hypothesis.n_effect_parameters :], starts)[0]
    return np.nan_to_num((with_it - without) * problem.data.weight)


def _unexplained_square(problem: EstimationProblem, mark: np.ndarray, other: HypothesisFit) -> float:
    """The square of ``mark`` that regression on the ``other`` effect and on all nuisance parameters
    leaves."""
    fit = other.fit
    spread = make_joint_prior(other.effects, problem.rollout_model).deviation
    curvature, gradient, _, _, start_moves = eliminate_starts(mark, fit.slopes, fit.start_slopes)
    flat = mark.reshape(len(mark), -1)
    # the effect itself has a flat prior, the nuisance parameters keep theirs
    precision = np.where(
        np.arange(len(spread)) < other.n_effect_parameters, 1e-9 * np.diag(curvature), 1.0 / spread**2
    )
    move = np.linalg.lstsq(curvature + np.diag(precision), gradient, rcond=1e-12)[0]
    started = float(np.sum((flat - np.einsum("wms,ws->wm", fit.start_slopes, start_moves)) ** 2))
    return max(started - float(gradient @ move), 0.0)
