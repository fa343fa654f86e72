"""Reasons against an explanation that fits: it would fit anything, or the sim itself explains as much.

A push at a given time explains anything that happens once. That it is external shows only where the mechanism
passes through the same state again without it, and that a force is periodic only where it repeats. An effect
with many parameters imitates a sim whose parameters are all somewhat wrong. Where the sim with relaxed priors
fits as well, with more evidence, the effect is not the cause.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from lagsplat.diagnose.core.config import IMPLAUSIBILITY
from lagsplat.diagnose.inference.model_selection import ModelRanking
from lagsplat.diagnose.inference.problem import EstimationProblem, HypothesisFit, compute_log_evidence


@dataclass(frozen=True)
class Implausibility:
    """A lower bound of P(unknown), and its reason.

    ``unrepeated``: an external force in states that occur only with it. ``shapeless``: several flexible
    effects. ``loose``: the sim with relaxed priors has more evidence.
    """

    chance: float
    why: Literal["unrepeated", "shapeless", "loose"]


def assess_implausibility(
    problem: EstimationProblem, ranking: ModelRanking, hypothesis: HypothesisFit, *, nominal: float
) -> Implausibility:
    """The strongest reason against an explanation; none against effects on single samples."""
    if hypothesis.moves_samples:
        return Implausibility(0.0, "loose")
    ahead = relaxed_model_log_evidence(
        problem, ranking.none, hypothesis, nominal=nominal, noise_inflation=ranking.noise_inflation
    )
    behind = (IMPLAUSIBILITY.relaxed_lead - ahead) / IMPLAUSIBILITY.relaxed_scatter
    loose = float(1.0 / (1.0 + np.exp(np.clip(behind, -50.0, 50.0))))
    unrepeated = IMPLAUSIBILITY.unrepeated_chance * (1.0 - measure_recurrence(hypothesis, problem))
    shapes = sum(placed.effect.flexible for placed in hypothesis.effects)
    reasons = (
        Implausibility(unrepeated, "unrepeated"),
        Implausibility(IMPLAUSIBILITY.flexible_chance if shapes > 1 else 0.0, "shapeless"),
        Implausibility(loose, "loose"),
    )
    return max(reasons, key=lambda reason: reason.chance)


def measure_recurrence(hypothesis: HypothesisFit, problem: EstimationProblem) -> float:
    """How clearly the data show that the external effects of a hypothesis are external, from 0 to 1.

    It is 1 where there are none.
    """
    record, shown = problem.dataset, 1.0
    for placed in hypothesis.effects:
        if placed.effect.recurrence is not None:
            parameters = hypothesis.name_parameters(placed)
            shown = min(shown, placed.effect.recurrence(parameters, record, placed))
    return shown


def relaxed_model_log_evidence(
    problem: EstimationProblem,
    none: HypothesisFit,
    best: HypothesisFit,
    *,
    nominal: float,
    noise_inflation: float,
) -> float:
    """Log evidence of the sim with relaxed priors, fitted from ``none``, over that of ``best`` [nat].

    Minus infinity where the relaxed sim fits worse, and where the sim misses even its own recordings
    (``nominal`` [noise variances]): then it fits anything.
    """
    if nominal > IMPLAUSIBILITY.max_nominal_misfit:
        return -np.inf
    rollout_model = problem.rollout_model
    loose = problem.with_nuisance(rollout_model.nuisance.scale_mechanics(IMPLAUSIBILITY.relaxation))
    fit = loose.fit((), none.fit.x, none.fit.starts)
    noise = nominal * problem.degrees_of_freedom
    if fit.misfit > max(best.fit.misfit, noise) + IMPLAUSIBILITY.relaxed_misfit_margin * noise:
        return -np.inf
    there = compute_log_evidence(HypothesisFit((), fit), loose.rollout_model, noise_inflation)
    return there - compute_log_evidence(best, rollout_model, noise_inflation)
