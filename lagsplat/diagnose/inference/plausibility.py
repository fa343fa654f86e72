"""What speaks against an explanation that leaves nothing unexplained: that it would explain anything.

Whether what seems to come from outside could as well depend on the state of the mechanism.

A push at a given time explains anything that happens once. That it came from outside shows only where the
mechanism passes through the same state again and nothing happens; that a force is periodic, only where it
repeats.

A sim whose parameters are all somewhat wrong, as the rival of every effect.

What moves several of the mechanism's own parameters at once can be imitated by an effect with enough freedom.
Where the sim explains as much with its parameters let loose, and is far more evident so, the effect is not
the cause.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from lagsplat.diagnose.core.config import IMPLAUSIBILITY
from lagsplat.diagnose.effects.base import SampleEffect
from lagsplat.diagnose.inference.evidence import HypothesisFit, log_evidence
from lagsplat.diagnose.inference.model_selection import ModelRanking
from lagsplat.diagnose.inference.problem import EstimationProblem


@dataclass(frozen=True)
class Implausibility:
    """P(unknown), at the least, for one reason.

    ``unrepeated``: an outer force in states that the record passes only with it. ``shapeless``: several
    effects that fit anything. ``loose``: the sim's own parameters, all moved, are more evident.
    """

    chance: float
    why: Literal["unrepeated", "shapeless", "loose"]


def assess_implausibility(
    problem: EstimationProblem, ranking: ModelRanking, hypothesis: HypothesisFit, *, nominal: float
) -> Implausibility:
    """The strongest doubt in ``hypothesis``, if it explains the gap; none in what only moves single
    samples."""
    if any(isinstance(placed.effect, SampleEffect) for placed in hypothesis.effects):
        return Implausibility(0.0, "loose")
    ahead = relaxed_model_log_evidence(
        problem, ranking.none, hypothesis, nominal=nominal, noise_inflation=ranking.noise_inflation
    )
    loose = 1.0 / (
        1.0
        + np.exp(np.clip((IMPLAUSIBILITY.relaxed_lead - ahead) / IMPLAUSIBILITY.relaxed_scatter, -50.0, 50.0))
    )
    shapes = sum(placed.effect.flexible for placed in hypothesis.effects)
    reasons = (
        Implausibility(
            IMPLAUSIBILITY.unrepeated_chance * (1.0 - recurrence(hypothesis, problem)), "unrepeated"
        ),
        Implausibility(IMPLAUSIBILITY.flexible_chance if shapes > 1 else 0.0, "shapeless"),
        Implausibility(float(loose), "loose"),
    )
    return max(reasons, key=lambda reason: reason.chance)


def recurrence(hypothesis: HypothesisFit, problem: EstimationProblem) -> float:
    """How far the record shows that the exogenous effects of ``hypothesis`` come from outside, from 0 to 1.

    One where there are none of them.
    """
    record, shown = problem.rollout_model.dataset, 1.0
    for placed in hypothesis.effects:
        if placed.effect.recurrence is not None:
            parameters = placed.name_parameters(hypothesis.fit.x[hypothesis.parameter_slice(placed)])
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
    """Nats by which the loosened sim is more evident than ``best``; minus infinity if it explains less.

    So it is where the sim misses even its own recordings: then to explain the rest is no achievement.
    """
    if nominal > IMPLAUSIBILITY.max_nominal_misfit:
        return -np.inf
    rollout_model = problem.rollout_model
    loose = replace(
        problem,
        rollout_model=replace(
            rollout_model, nuisance=rollout_model.nuisance.scale_mechanics(IMPLAUSIBILITY.relaxation)
        ),
    )
    fit = loose.fit((), none.fit.x, none.fit.starts)
    noise = nominal * problem.degrees_of_freedom
    if fit.misfit > max(best.fit.misfit, noise) + IMPLAUSIBILITY.relaxed_misfit_margin * noise:
        return -np.inf
    there = log_evidence(HypothesisFit((), fit), loose.rollout_model, noise_inflation)
    return there - log_evidence(best, rollout_model, noise_inflation)
