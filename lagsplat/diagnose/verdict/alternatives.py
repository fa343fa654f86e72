"""What a verdict chooses between, and what is measured of each: `none`, effects, sets of effects.

Measures say how well an alternative explains a recording: in the fit, on windows that were held out, beside
its rivals, and at what cost. Names of effects are no measures, so that a choice among known effects teaches
what an unknown one looks like.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lagsplat.diagnose.core.config import PROBLEM, VERDICT
from lagsplat.diagnose.estimation.multiple_shooting import compute_autocorrelation_time
from lagsplat.diagnose.inference.effect_search import EffectSearch
from lagsplat.diagnose.inference.holdout import HeldOutBlocks, split_windows
from lagsplat.diagnose.inference.model_selection import ModelRanking
from lagsplat.diagnose.inference.problem import (
    EstimationProblem,
    HypothesisFit,
    compute_excess_penalty,
    compute_log_evidence,
)

FEWEST_FREE = 1.0  # fewest degrees of freedom that a mean square is taken over [count]


@dataclass(frozen=True)
class Measures:
    """What is measured of `none`, an effect or a set of effects."""

    names: tuple[str, ...]  # effects, in the order of the alphabet; empty for `none`
    misfit: float  # mean square residual [noise variances]
    log_evidence: float  # over `none`, at a noise that all alternatives of a recording share [nat]
    error: float  # root mean square of held-out forecasts [rms of each coordinate]
    floor: float  # the same of a true law, from the noise
    gain_z: float  # drop of the log square error of held-out blocks, refit to this, in standard errors [1]
    parameters: int  # fitted parameters of the effects
    surprise: float  # squared distance of these from their prior means [prior variances]
    memory: float  # samples of the residual that count as one independent sample, over those of a true law's
    refit_penalty: float  # penalty of the sim's own parameters beyond their prior [noise variances]
    single_samples: bool  # whether it moves single samples, which no forecast shows
    flexible: int  # effects that imitate many others
    recurrence: float  # how clearly the data show that external effects are external, from 0 to 1


@dataclass(frozen=True)
class Alternatives:
    """All measured alternatives of a recording with their fits; the first is `none`."""

    measures: tuple[Measures, ...]
    fits: tuple[HypothesisFit, ...]
    nominal: float  # mean square residual of a true law [noise variances]
    chance: float  # standard deviation of a mean square residual, relative [1]
    relaxed_log_evidence: float  # log evidence over `none` of the sim with relaxed priors [nat]
    motionless: float  # mean square residual of a sim at rest [noise variances]

    @property
    def explained(self) -> bool:
        """Whether the best alternative explains at least a half of the motion."""
        return self.least_misfit <= (1.0 - PROBLEM.min_explained_share) * self.motionless

    @property
    def best(self) -> Measures:
        """The alternative with the most evidence; `none`, whose log evidence is zero, is one."""
        return max(self.measures, key=lambda m: m.log_evidence)

    @property
    def best_single(self) -> Measures | None:
        """The single effect with the most evidence, if any was fitted."""
        single = (m for m in self.measures if len(m.names) == 1)
        return max(single, key=lambda m: m.log_evidence, default=None)

    @property
    def least_misfit(self) -> float:
        """The least mean square residual [noise variances]."""
        return min(m.misfit for m in self.measures)

    @property
    def least_error(self) -> float:
        """The least held-out error [rms of each coordinate]."""
        return min(m.error for m in self.measures)


def measure_alternatives(search: EffectSearch) -> Alternatives:
    """Measure `none`, each effect at its best place, and the sets of several effects."""
    problem, ranking, budget = search.problem, search.ranking, search.budget
    best: dict[str, HypothesisFit] = {}
    for fit in ranking.found:
        best.setdefault(fit.name, fit)
    sets = (fit for fit in (*search.sets, *search.rivals) if len(fit.effects) > 1)
    fits = (ranking.none, *best.values(), *sets)
    length = problem.windows.length
    freedom, ratio = max(problem.degrees_of_freedom, FEWEST_FREE), budget.effective_sample_ratio
    chance = float(np.sqrt(2.0 * ratio / freedom))
    least = min(fit.fit.misfit for fit in fits) / freedom
    level = estimate_noise_level(budget.nominal, least, chance)
    inflation = max(level, least) * ratio
    forecasts = _forecast_all(problem, fits, level=level)
    base = compute_log_evidence(ranking.none, problem.rollout_model, inflation)

    def compare_evidence(fit: HypothesisFit) -> float:
        if fit.moves_samples or not fit.effects:
            return fit.log_evidence
        ahead = compute_log_evidence(fit, problem.rollout_model, inflation)
        return ahead - base - budget.log_evidence_offset

    # errors of a learned law are correlated where nothing is missing as well
    usual_memory = ratio if np.any(problem.own_error) else 1.0
    measures = []
    for fit, (squares, floor) in zip(fits, forecasts, strict=True):
        priors = [p.prior for placed in fit.fitted for p in placed.effect.parameters]
        distance = [(x - p.mean) / p.deviation for x, p in zip(fit.fit.x, priors, strict=False)]
        measures.append(
            Measures(
                names=tuple(sorted(placed.effect.name for placed in fit.effects)),
                misfit=max(fit.fit.misfit / freedom, 1e-12),
                log_evidence=compare_evidence(fit),
                error=float(np.sqrt(squares.mean())),
                floor=float(np.sqrt(floor.mean())),
                gain_z=_compute_gain_z(forecasts[0][0], squares),
                parameters=fit.n_effect_parameters,
                surprise=float(np.square(distance).sum()),
                memory=max(compute_autocorrelation_time(fit.fit.residual, length) / usual_memory, 1.0),
                refit_penalty=compute_excess_penalty(fit.fit, budget.nominal * ratio),
                single_samples=fit.moves_samples,
                flexible=sum(placed.effect.flexible for placed in fit.effects),
                recurrence=measure_recurrence(fit, problem),
            )
        )
    relaxed, loose = _fit_relaxed(problem, ranking)
    lead = compute_log_evidence(relaxed, loose.rollout_model, inflation) - base
    return Alternatives(tuple(measures), fits, level, chance, lead, problem.motionless_misfit)


def estimate_noise_level(nominal: float, least: float, chance: float) -> float:
    """Mean square residual of a true law [noise variances].

    It is that of the sim on its own recordings, ``nominal``, at least 1. Where even the best fit leaves less
    than the noise, the noise was taken for larger than it is: it is no more than the ``least`` residual and
    two standard deviations, ``chance``.
    """
    return nominal if nominal > 1.0 else min(1.0, least * (1.0 + 2.0 * chance))


def _forecast_all(
    problem: EstimationProblem, fits: Sequence[HypothesisFit], *, level: float
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Held-out square errors of each block and their floors; where nothing is held out, those of the fits."""
    try:
        windows = HeldOutBlocks(problem, split_windows(problem, fits[0]))
    except ValueError:
        freedom = max(problem.degrees_of_freedom, FEWEST_FREE)
        size = float(np.mean((problem.sigma / np.std(problem.dataset.q, axis=0)) ** 2))
        return [(np.array([size * fit.fit.misfit / freedom]), np.array([size * level])) for fit in fits]
    every = [windows.forecast(fit) for fit in fits]
    return [(forecast.squares, min(level, 1.0) * forecast.floor) for forecast in every]


def measure_recurrence(hypothesis: HypothesisFit, problem: EstimationProblem) -> float:
    """How clearly the data show that the external effects of a hypothesis are external, from 0 to 1.

    A push at a given time explains anything that happens once. That it is external shows only where the
    mechanism passes through the same state again without it, and that a force is periodic only where it
    repeats. It is 1 where nothing is external.
    """
    shown = [
        placed.effect.recurrence(hypothesis.name_parameters(placed), problem.dataset, placed)
        for placed in hypothesis.effects
        if placed.effect.recurrence is not None
    ]
    return min(shown, default=1.0)


def _compute_gain_z(before: np.ndarray, after: np.ndarray) -> float:
    """Mean drop of the logarithm of the blocks' square errors over its standard error; 0 with one block."""
    drop = np.log(np.maximum(before, 1e-300)) - np.log(np.maximum(after, 1e-300))
    spread = float(np.std(drop, ddof=1)) if len(drop) > 1 else 0.0
    return float(np.mean(drop)) / spread * np.sqrt(len(drop)) if spread > 0.0 else 0.0


def _fit_relaxed(
    problem: EstimationProblem, ranking: ModelRanking
) -> tuple[HypothesisFit, EstimationProblem]:
    """The sim alone with relaxed priors of its own parameters, and the problem with these priors."""
    nuisance = problem.rollout_model.nuisance.scale_mechanics(VERDICT.relaxation)
    loose = problem.with_nuisance(nuisance)
    return HypothesisFit((), loose.fit((), ranking.none.fit.x, ranking.none.fit.starts)), loose
