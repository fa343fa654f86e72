"""A diagnosis from end to end: from a simulator and real trajectories to the verdict and its evidence."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from lagsplat.diagnose.core.config import VERDICT, DiagnoseConfig
from lagsplat.diagnose.core.result import Candidate, Diagnosis
from lagsplat.diagnose.effects.base import PlacedEffect
from lagsplat.diagnose.identification.estimated_simulator import EstimatedSimulator
from lagsplat.diagnose.inference import posterior
from lagsplat.diagnose.inference.effect_search import EffectSearch, search_effects
from lagsplat.diagnose.inference.holdout import HoldoutForecasts, estimate_single_closure, forecast_holdout
from lagsplat.diagnose.inference.model_selection import ModelRanking, SearchBudget
from lagsplat.diagnose.inference.placement import find_hints, place_effects
from lagsplat.diagnose.inference.problem import EstimationProblem, HypothesisFit, build_problem
from lagsplat.diagnose.inference.profile_likelihood import estimate_parameters
from lagsplat.diagnose.inference.robustness import check_robustness
from lagsplat.io.trajectory.trajectory import Trajectory


@dataclass(frozen=True)
class DiagnosisRun:
    """A diagnosis with all fits that it compared, and the chosen fit."""

    diagnosis: Diagnosis
    search: EffectSearch
    chosen: HypothesisFit

    @property
    def problem(self) -> EstimationProblem:
        """The estimation problem of all hypotheses."""
        return self.search.problem

    @property
    def ranking(self) -> ModelRanking:
        """The fits of single effects."""
        return self.search.ranking


def diagnose(
    sim: EstimatedSimulator,
    real: Sequence[Trajectory],
    config: DiagnoseConfig,
    *,
    log_evidence_offset: float = 0.0,
    report_progress: Callable[[str], None] = lambda name: None,
) -> DiagnosisRun:
    """Find out why a simulator and real trajectories disagree.

    Args:
        sim: the simulator with what is uncertain about it.
        real: real trajectories, cut where they are not continued.
        config: settings of the diagnosis.
        log_evidence_offset: what effects gain by the sim's own errors [nat]; see `calibrate_null_evidence`.
        report_progress: called with the name of each effect before it is fitted.

    Raises:
        ValueError: the motions are too short for a single window.
    """
    problem, q_names, u_names = build_problem(sim, real, config), real[0].q_names, real[0].u_names
    hints = find_hints(sim.model, real, period_s=problem.period_s, hold=config.input_hold)
    candidates = place_effects(
        problem.rollout_model,
        hints,
        q_names=q_names,
        u_names=u_names,
        without=config.without,
        targets=config.targets,
    )

    budget = SearchBudget(config, max(1.0, sim.misfit), log_evidence_offset)
    search = search_effects(problem, candidates, budget, report_progress=report_progress)
    problem, budget, ranking, chain = search.problem, search.budget, search.ranking, search.sets
    judgement = posterior.judge_hypotheses(
        ranking,
        chain,
        posterior.GapMeasure(problem.degrees_of_freedom, budget.nominal, config),
        most=problem.motionless_misfit,
        doubt=partial(posterior.assess_implausibility, problem, ranking, nominal=budget.nominal),
    )
    best, warnings = judgement.best, _list_warnings(problem)
    chosen = best if best is not None and judgement.verdict == "effect" else ranking.none
    try:
        given = (sim.original or sim).model
        holdout = forecast_holdout(problem, ranking.none, chosen, given=given)
    except ValueError as error:
        holdout, warnings = None, [f"no closure: {error}", *warnings]
    if best is not None and chosen is best and _is_immaterial(problem, ranking, holdout, best, config):
        judgement, chosen = posterior.reject_effect(judgement), ranking.none
    checks = {
        "natural_period_s": problem.period_s,
        "noise": problem.sigma.tolist(),
        **_measure_fits(sim, problem, ranking, chain, judgement),
        **check_robustness(problem, ranking, chain, judgement, candidates, budget),
    }
    diagnosis = Diagnosis(
        verdict=judgement.verdict,
        candidates=_list_candidates(problem, ranking, judgement, holdout),
        combination=tuple(e.effect.name for e in chosen.effects),
        gap=holdout.gap if holdout else None,
        where=None,
        equivalent=judgement.equivalent if chosen.effects else (),
        excitation=(),
        warnings=tuple(warnings),
        absorbed=(),
        blocks=holdout.blocks if holdout else (),
        checks=checks,
        q_names=q_names,
        u_names=u_names,
    )
    return DiagnosisRun(diagnosis, search, chosen)


def _measure_fits(
    sim: EstimatedSimulator,
    problem: EstimationProblem,
    ranking: ModelRanking,
    chain: Sequence[HypothesisFit],
    judgement: posterior.Judgement,
) -> dict[str, Any]:
    """Mean square residuals [noise variances] and factors on the noise, as `Diagnosis.checks` lists them.

    Those of the sim are on its own recordings, now and before a recalibration.
    """

    def measure(hypothesis: HypothesisFit) -> float:
        return hypothesis.fit.misfit / problem.degrees_of_freedom

    sets = [{"effects": [e.effect.name for e in fit.effects], "misfit": measure(fit)} for fit in chain]
    as_given = {"sim_misfit_as_given": sim.original.misfit} if sim.original else {}
    return {
        "sim_misfit": sim.misfit,
        **as_given,
        "misfit_none": measure(ranking.none),
        "misfit_best": measure(judgement.best or ranking.none),
        "unexplained": judgement.unexplained,
        "doubt": judgement.implausibility,
        "chain": sets,
        "windows": len(problem.windows.first),
        "temper": ranking.noise_inflation,
        "price": problem.noise_inflation,
    }


def _list_warnings(problem: EstimationProblem) -> list[str]:
    """The warning that windows were left out in which the sim was never seen."""
    if not problem.excluded_windows:
        return []
    share = problem.excluded_windows / (problem.excluded_windows + len(problem.windows.first))
    return [
        f"{100.0 * share:.2g} % of the recording was left aside: there it is driven, or moves, as the sim's "
        "own recordings nowhere do (a sudden release, say), and what the sim foretells of it is chance"
    ]


def _is_immaterial(
    problem: EstimationProblem,
    ranking: ModelRanking,
    holdout: HoldoutForecasts | None,
    best: HypothesisFit,
    config: DiagnoseConfig,
) -> bool:
    """Whether the best explanation improves the held-out forecasts too little to be named."""
    if holdout is None:
        return False
    gap, misfit = holdout.gap, ranking.none.fit.misfit / problem.degrees_of_freedom
    if misfit < VERDICT.overestimated_noise_misfit and gap.before <= gap.floor:
        return True
    return (
        best.log_evidence < VERDICT.certain_log_evidence
        and gap.before - gap.after < config.materiality * gap.before
        and gap.before < VERDICT.close_floor_ratio * gap.floor
    )


def _list_candidates(
    problem: EstimationProblem,
    ranking: ModelRanking,
    judgement: posterior.Judgement,
    holdout: HoldoutForecasts | None,
) -> tuple[Candidate, ...]:
    fits: dict[str, tuple[HypothesisFit, PlacedEffect]] = {}
    for hypothesis in ranking.found:
        fits.setdefault(hypothesis.name, (hypothesis, hypothesis.effects[-1]))
    if judgement.best is not None:
        fits |= {placed.effect.name: (judgement.best, placed) for placed in judgement.best.effects}
    out = []
    for number, (name, probability) in enumerate(judgement.probabilities.items()):
        if name not in fits:
            out.append(Candidate(name, probability))
            continue
        hypothesis, placed = fits[name]
        closure = None
        if number < VERDICT.max_closures and holdout is not None and placed.changes_motion:
            closure = estimate_single_closure(problem, hypothesis, holdout)
        out.append(
            Candidate(
                name,
                probability,
                coordinate=placed.direction.name if placed.direction else None,
                input=placed.input_name,
                places=tuple(str(part.location) for part in placed.parts),
                parameters=estimate_parameters(problem, hypothesis, placed, ranking.noise_inflation),
                closure=closure,
                log_evidence=hypothesis.log_evidence,
                misfit=hypothesis.fit.misfit / problem.degrees_of_freedom,
            )
        )
    return tuple(out)
