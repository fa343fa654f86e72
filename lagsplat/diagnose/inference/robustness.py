"""Noise inflation where no hypothesis fits, and whether the verdict survives other noise.

Where the best explanation misses by many times the noise, the laws are wrong, and their errors are correlated
over many samples. Taken as white noise, these samples would outweigh the priors: the nuisance parameters
would move by hundreds of standard deviations to close the gap, and `none` would look good. So the remaining
misfit counts as noise, and correlated samples count as one.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from lagsplat.diagnose.core.config import ROBUSTNESS
from lagsplat.diagnose.effects.base import PlacedEffect
from lagsplat.diagnose.effects.registry import find_confusable
from lagsplat.diagnose.inference.model_selection import ModelRanking, SearchBudget, rank_by_evidence
from lagsplat.diagnose.inference.posterior import GapMeasure, Implausibility, Judgement, judge_hypotheses
from lagsplat.diagnose.inference.problem import EstimationProblem, HypothesisFit, compute_autocorrelation_time


def inflate_noise(
    problem: EstimationProblem, budget: SearchBudget, best: HypothesisFit
) -> tuple[EstimationProblem, SearchBudget] | None:
    """Inflate the noise to the misfit that the ``best`` explanation leaves; None if that is nearly nominal.

    The median over the windows counts: a push by hand in a few of them is no error of the law.
    """
    length = problem.windows.length
    window_misfits = [(row[:n] ** 2).mean() for row, n in zip(best.fit.residual, length, strict=True)]
    misfit = min(best.fit.misfit / problem.degrees_of_freedom, float(np.median(window_misfits)))
    if misfit <= ROBUSTNESS.inflation_misfit * budget.nominal:
        return None
    correlation = compute_autocorrelation_time(best.fit.residual, length)
    noise_inflation = max(problem.noise_inflation, misfit * correlation)
    return replace(problem, noise_inflation=noise_inflation), replace(budget, correlation=correlation)


def check_robustness(
    problem: EstimationProblem,
    ranking: ModelRanking,
    chain: Sequence[HypothesisFit],
    judgement: Judgement,
    candidates: Sequence[PlacedEffect],
    budget: SearchBudget,
) -> dict[str, Any]:
    """Repeat the verdict with half and twice the noise, undistorted coordinates, and added noise (twice).

    Only the leading effects are fitted again, and the implausibility of the explanation is kept. Returns the
    most probable name in each repeat, ``answers``, and whether too few agree with the verdict, ``fragile``.
    """
    best = [ranking.best_fit(name) for name in judgement.probabilities]
    # effects on single samples need no fit
    refitted = [fit for fit in best if fit is not None and not fit.moves_samples]
    leading = refitted[: ROBUSTNESS.refitted_effects]
    doubted = Implausibility(judgement.probabilities["unknown"] if judgement.implausibility else 0.0, "loose")
    answers = {}
    for name, perturbed, nominal in _perturbed_problems(problem, budget.nominal):
        none, *singles = (_refit(perturbed, hypothesis) for hypothesis in (ranking.none, *leading))
        again = rank_by_evidence(perturbed, none, singles, candidates, replace(budget, nominal=nominal))
        sets = []
        for hypothesis in chain:
            alone = again.best_fit(hypothesis.name) if len(hypothesis.effects) == 1 else None
            sets.append(alone or _refit(perturbed, hypothesis))
        answers[name] = judge_hypotheses(
            again,
            sets,
            GapMeasure(perturbed.degrees_of_freedom, nominal, budget.config),
            most=perturbed.motionless_misfit,
            doubt=lambda hypothesis: doubted,
        ).most_probable
    agreeing = {judgement.most_probable} | find_confusable(judgement.most_probable)
    n_agreeing = sum(answer in agreeing for answer in answers.values())
    return {"fragile": n_agreeing < ROBUSTNESS.min_agreeing, "answers": answers}


def _refit(problem: EstimationProblem, hypothesis: HypothesisFit) -> HypothesisFit:
    """A few more iterations of a fit; one with an effect on single samples stays as it is."""
    if hypothesis.moves_samples:
        return hypothesis
    brief = replace(problem, iterations=ROBUSTNESS.iterations)
    return replace(hypothesis, fit=brief.fit(hypothesis.effects, hypothesis.fit.x, hypothesis.fit.starts))


def _perturbed_problems(
    problem: EstimationProblem, nominal: float
) -> Iterator[tuple[str, EstimationProblem, float]]:
    """Name, perturbed problem, and the nominal misfit in the noise that it assumes."""
    rollout_model, sigma = problem.rollout_model, problem.sigma
    nuisance, record = rollout_model.nuisance, rollout_model.dataset
    for name, factor in (("half the noise", 0.5), ("twice the noise", 2.0)):
        noise_inflation = max(1.0, problem.noise_inflation / factor**2)
        other = replace(problem, sigma=factor * sigma, noise_inflation=noise_inflation)
        yield name, other, max(1.0, nominal / factor**2)
    flat = replace(nuisance, warp=ROBUSTNESS.frozen_warp_share * nuisance.warp)
    yield "coordinates not bent", problem.with_nuisance(flat), nominal
    for seed in ROBUSTNESS.noise_seeds:
        noise = np.random.default_rng(seed).normal(0.0, sigma, record.q.shape)
        noisy = replace(rollout_model, dataset=replace(record, q=record.q + noise))
        louder = replace(problem, rollout_model=noisy, sigma=np.sqrt(2.0) * sigma)
        yield f"noise added, seed {seed}", louder, max(1.0, 0.5 * (nominal + 1.0))
