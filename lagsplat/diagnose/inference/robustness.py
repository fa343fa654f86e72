"""Noise inflation where no hypothesis fits, and whether the verdict survives other noise.

Where the best explanation misses by many times the noise, the laws are wrong, and their errors are correlated
over many samples. Taken as white noise, these samples would outweigh the priors: the nuisance parameters
would move by hundreds of standard deviations to close the gap, and `none` would look good. So the remaining
misfit counts as noise, and correlated samples count as one.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from lagsplat.diagnose.core.config import ROBUSTNESS, DiagnoseConfig
from lagsplat.diagnose.effects.base import PlacedEffect, SampleEffect
from lagsplat.diagnose.effects.registry import find_confusable
from lagsplat.diagnose.inference.model_selection import ModelRanking, SearchBudget, rank_by_evidence
from lagsplat.diagnose.inference.plausibility import Implausibility
from lagsplat.diagnose.inference.posterior import Judgement, compute_motionless_misfit, judge_hypotheses
from lagsplat.diagnose.inference.problem import EstimationProblem, HypothesisFit, compute_autocorrelation_time


def inflate_noise(
    problem: EstimationProblem, budget: SearchBudget, best: HypothesisFit
) -> tuple[EstimationProblem, SearchBudget] | None:
    """Inflate the noise to the misfit that the ``best`` explanation leaves; None if that is near the nominal
    one.

    The median over the windows counts: a push by hand in a few of them is no error of the law.
    """
    window_misfits = [
        (row[:n] ** 2).mean() for row, n in zip(best.fit.residual, problem.windows.length, strict=True)
    ]
    misfit = min(best.fit.misfit / problem.degrees_of_freedom, float(np.median(window_misfits)))
    if misfit <= ROBUSTNESS.inflation_misfit * budget.nominal:
        return None
    correlation = compute_autocorrelation_time(best.fit.residual, problem.windows.length)
    noise_inflation = max(problem.noise_inflation, misfit * correlation)
    return replace(problem, noise_inflation=noise_inflation), replace(
        budget, effective_sample_ratio=max(budget.effective_sample_ratio, correlation)
    )


@dataclass(frozen=True)
class RobustnessCheck:
    """The most probable name in each repeat, and whether too few agree with the verdict."""

    fragile: bool
    answers: dict[str, str]


def check_robustness(
    problem: EstimationProblem,
    ranking: ModelRanking,
    chain: Sequence[HypothesisFit],
    judgement: Judgement,
    candidates: Sequence[PlacedEffect],
    budget: SearchBudget,
    config: DiagnoseConfig,
) -> RobustnessCheck:
    """Repeat the verdict with half and twice the noise, undistorted coordinates, and added noise (twice).

    Only the leading effects are fitted again, and the implausibility of the explanation is kept.
    """
    leading = _leading_fits(ranking, judgement)
    doubted = Implausibility(judgement.probabilities["unknown"] if judgement.implausibility else 0.0, "loose")
    answers = {}
    for name, perturbed, nominal in _perturbed_problems(problem, budget.nominal):
        again = replace(budget, nominal=nominal)
        ranking_again = _judge_again(
            perturbed, ranking, chain, leading, candidates, again, config, lambda hypothesis: doubted
        )
        answers[name] = find_most_probable_name(ranking_again)
    verdict_name = find_most_probable_name(judgement)
    agreeing = {verdict_name} | find_confusable(verdict_name)
    return RobustnessCheck(
        sum(hypothesis in agreeing for hypothesis in answers.values()) < ROBUSTNESS.min_agreeing, answers
    )


def find_most_probable_name(judgement: Judgement) -> str:
    """The most probable name."""
    return next(iter(judgement.probabilities))


def _leading_fits(ranking: ModelRanking, judgement: Judgement) -> list[HypothesisFit]:
    """The best fits of the most probable names; effects on single samples are left out, they need no fit."""
    names = [name for name in judgement.probabilities if ranking.best_fit(name) is not None]
    best = [hypothesis for hypothesis in map(ranking.best_fit, names) if hypothesis is not None]
    return [hypothesis for hypothesis in best if not _is_sample_noise(hypothesis)][
        : ROBUSTNESS.refitted_effects
    ]


def _is_sample_noise(hypothesis: HypothesisFit) -> bool:
    return any(isinstance(placed.effect, SampleEffect) for placed in hypothesis.effects)


def _perturbed_problems(
    problem: EstimationProblem, nominal: float
) -> Iterator[tuple[str, EstimationProblem, float]]:
    """Name, perturbed problem, and the nominal misfit in the noise that it assumes."""
    rollout_model, sigma = problem.rollout_model, problem.sigma
    for name, factor in (("half the noise", 0.5), ("twice the noise", 2.0)):
        noise_inflation = max(1.0, problem.noise_inflation / factor**2)
        yield (
            name,
            replace(problem, sigma=factor * sigma, noise_inflation=noise_inflation),
            max(1.0, nominal / factor**2),
        )
    flat = replace(rollout_model.nuisance, warp=ROBUSTNESS.frozen_warp_share * rollout_model.nuisance.warp)
    yield (
        "coordinates not bent",
        replace(problem, rollout_model=replace(rollout_model, nuisance=flat)),
        nominal,
    )
    for seed in ROBUSTNESS.noise_seeds:
        noise = np.random.default_rng(seed).normal(0.0, sigma, rollout_model.dataset.q.shape)
        noisy = replace(
            rollout_model, dataset=replace(rollout_model.dataset, q=rollout_model.dataset.q + noise)
        )
        louder = replace(problem, rollout_model=noisy, sigma=np.sqrt(2.0) * sigma)
        yield f"noise added, seed {seed}", louder, max(1.0, 0.5 * (nominal + 1.0))


def _judge_again(
    shaken: EstimationProblem,
    ranking: ModelRanking,
    chain: Sequence[HypothesisFit],
    leading: Sequence[HypothesisFit],
    candidates: Sequence[PlacedEffect],
    budget: SearchBudget,
    config: DiagnoseConfig,
    doubt: Callable[[HypothesisFit], Implausibility],
) -> Judgement:
    brief = replace(shaken, iterations=ROBUSTNESS.iterations)

    def refit(hypothesis: HypothesisFit) -> HypothesisFit:
        return replace(hypothesis, fit=brief.fit(hypothesis.effects, hypothesis.fit.x, hypothesis.fit.starts))

    none, singles = refit(ranking.none), [refit(hypothesis) for hypothesis in leading]
    ranking_again = rank_by_evidence(shaken, none, singles, candidates, budget, first=True)
    sets = []
    for hypothesis in chain:
        alone = ranking_again.best_fit(hypothesis.name) if len(hypothesis.effects) == 1 else None
        sets.append(alone or (hypothesis if _is_sample_noise(hypothesis) else refit(hypothesis)))
    return judge_hypotheses(
        ranking_again,
        sets,
        shaken.degrees_of_freedom,
        budget.nominal,
        config,
        most=compute_motionless_misfit(shaken),
        doubt=doubt,
    )
