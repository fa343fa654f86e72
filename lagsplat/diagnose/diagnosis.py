"""A diagnosis from end to end: from a simulator and real trajectories to the verdict and its evidence."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from lagsplat.diagnose.core.config import PROBLEM, VERDICT, DiagnoseConfig
from lagsplat.diagnose.core.result import Candidate, Diagnosis, Interval
from lagsplat.diagnose.effects.base import PlacedEffect
from lagsplat.diagnose.effects.registry import catalogue, list_effects
from lagsplat.diagnose.identification.estimated_simulator import EstimatedSimulator
from lagsplat.diagnose.inference.effect_search import EffectSearch, search_effects
from lagsplat.diagnose.inference.excitation import grade_excitation
from lagsplat.diagnose.inference.holdout import HoldoutForecasts, forecast_holdout
from lagsplat.diagnose.inference.model_selection import ModelRanking, SearchBudget
from lagsplat.diagnose.inference.placement import find_hints, place_effects
from lagsplat.diagnose.inference.problem import EstimationProblem, HypothesisFit, build_problem
from lagsplat.diagnose.inference.profile_likelihood import estimate_parameters, estimate_refit
from lagsplat.diagnose.verdict.alternatives import Alternatives, measure_alternatives
from lagsplat.diagnose.verdict.choice_model import ChoiceModel, load_choice_model
from lagsplat.diagnose.verdict.judgement import Judgement, judge_alternatives
from lagsplat.io.trajectory.trajectory import Trajectory

LAWLESS = (
    "the simulation misses more than half of the motion of its own recordings, so that nothing can be said "
    "of others: fit it longer, or look at its rollouts first"
)
UNEXPLAINED = (
    "the simulation explains less than half of the real motion, whatever is added to it: compare units, "
    "signs, inputs and starts of both"
)


@dataclass(frozen=True)
class DiagnosisRun:
    """A diagnosis with all fits that it compared, the chosen one, and forecasts of held-out blocks."""

    diagnosis: Diagnosis
    search: EffectSearch
    alternatives: Alternatives
    chosen: HypothesisFit
    holdout: HoldoutForecasts | None

    @property
    def problem(self) -> EstimationProblem:
        """The estimation problem of all hypotheses."""
        return self.search.problem

    @property
    def ranking(self) -> ModelRanking:
        """The fits of single effects."""
        return self.search.ranking


def search_gap(
    sim: EstimatedSimulator,
    real: Sequence[Trajectory],
    config: DiagnoseConfig,
    log_evidence_offset: float = 0.0,
    *,
    report_progress: Callable[[str], None] = lambda name: None,
) -> EffectSearch:
    """Place the effects of the catalogue, and fit them and sets of them; the arguments are `diagnose`'s.

    Raises:
        ValueError: the motions are too short for a single window.
    """
    problem = build_problem(sim, real, config)
    hints = find_hints(sim.model, real, period_s=problem.period_s, hold=config.input_hold)
    candidates = place_effects(
        problem.rollout_model,
        hints,
        q_names=real[0].q_names,
        u_names=real[0].u_names,
        without=config.without,
        targets=config.targets,
        computed=real[0].computed,
    )
    budget = SearchBudget(config, max(1.0, sim.misfit), log_evidence_offset)
    return search_effects(problem, candidates, budget, report_progress=report_progress)


def diagnose(
    sim: EstimatedSimulator,
    real: Sequence[Trajectory],
    config: DiagnoseConfig,
    *,
    log_evidence_offset: float = 0.0,
    report_progress: Callable[[str], None] = lambda name: None,
    model: ChoiceModel | None = None,
    tolerances_are_causes: bool = True,
) -> DiagnosisRun:
    """Find out why a simulator and real trajectories disagree.

    A gap that the tolerances of the sim's own parameters close is no missing effect, but a finding: its cause
    is then sought beside a sim without tolerances, which has but the uncertainty of its identification.

    Args:
        sim: the simulator with what is uncertain about it.
        real: real trajectories, cut where they are not continued.
        config: settings of the diagnosis.
        log_evidence_offset: what effects gain by the sim's own errors [nat]; see `calibrate_null_evidence`.
        report_progress: called with the name of each effect before it is fitted.
        model: weighs the alternatives; by default the calibrated one of this package.
        tolerances_are_causes: whether a parameter that is off within its tolerance is a cause; it is none
            where the sim was learned or recalibrated, as its parameters were never set.

    Raises:
        ValueError: the motions are too short for a single window.
    """
    model = model or load_choice_model()
    run = _judge_gap(sim, real, config, log_evidence_offset, report_progress, model)
    if run.diagnosis.verdict != "none" or not tolerances_are_causes or sim.original is not None:
        return run
    if run.holdout is None or not is_within_tolerance(run.holdout):
        return run
    exact = _judge_gap(sim, real, config.without_tolerances(), log_evidence_offset, report_progress, model)
    if exact.diagnosis.verdict != "effect":
        return run
    before, found = run.diagnosis, exact.diagnosis
    gap = replace(found.gap, refit=before.gap.refit) if found.gap and before.gap else found.gap
    checks = {**found.checks, "within_tolerance": True, "refit": before.checks["refit"]}
    return replace(exact, diagnosis=replace(found, gap=gap, checks=checks))


def _judge_gap(
    sim: EstimatedSimulator,
    real: Sequence[Trajectory],
    config: DiagnoseConfig,
    log_evidence_offset: float,
    report_progress: Callable[[str], None],
    model: ChoiceModel,
) -> DiagnosisRun:
    q_names, u_names = real[0].q_names, real[0].u_names
    search = search_gap(sim, real, config, log_evidence_offset, report_progress=report_progress)
    problem, ranking = search.problem, search.ranking
    alternatives = measure_alternatives(search)
    names = [name for name in catalogue() if name not in config.without]
    judgement = judge_alternatives(alternatives, model, catalogue=names)
    best, warnings = judgement.best, _list_warnings(problem)
    chosen = best if best is not None and judgement.verdict == "effect" else ranking.none
    try:
        given = (sim.original or sim).model
        holdout = forecast_holdout(problem, ranking.none, chosen, given=given)
    except ValueError as error:
        holdout, warnings = None, [f"no closure: {error}", *warnings]
    effects = [effect for effect in list_effects() if effect.name in names]
    excitation = grade_excitation(ranking.information, effects)
    checks = {
        "natural_period_s": problem.period_s,
        "noise": problem.sigma.tolist(),
        **_find_undetermined(problem, alternatives),
        "refit": estimate_refit(problem, ranking.none, ranking.noise_inflation, (q_names, u_names)),
        **_measure_fits(sim, search, judgement),
        "excitation": [asdict(row) for row in excitation],
    }
    if chosen is best and holdout is not None and not is_material(chosen, holdout, config.materiality):
        names = [placed.effect.name for placed in chosen.effects]
        checks["immaterial"] = {"effects": names, "share": asdict(holdout.beyond_refit)}
        judgement, chosen = judgement.reject("none"), ranking.none
    if holdout is not None and judgement.verdict in ("none", "unknown"):
        if is_open(holdout.refit_over_floor):
            judgement = judgement.reject("unknown")
        elif is_closed(holdout.refit_over_floor):
            judgement = judgement.reject("none")
        else:
            checks["undetermined"] = [*checks.get("undetermined", []), _describe_doubt(holdout)]
    diagnosis = Diagnosis(
        verdict=judgement.verdict,
        candidates=_list_candidates(problem, ranking, judgement, holdout),
        combination=tuple(e.effect.name for e in chosen.effects),
        gap=holdout.gap if holdout else None,
        where=None,
        equivalent=judgement.equivalent if chosen.effects else (),
        excitation=tuple(f"{row.effect}: {row.record}" for row in excitation if row.record),
        warnings=tuple(warnings),
        absorbed=(),
        blocks=holdout.blocks if holdout else (),
        checks=checks,
        q_names=q_names,
        u_names=u_names,
    )
    return DiagnosisRun(diagnosis, search, alternatives, chosen, holdout)


def _find_undetermined(problem: EstimationProblem, alternatives: Alternatives) -> dict[str, list[str]]:
    """Why nothing can be said, as `Diagnosis.checks` lists it; empty if something can."""
    own = float(np.mean(problem.own_error / np.var(problem.dataset.q, axis=0)))
    reasons = [UNEXPLAINED] * (not alternatives.explained)
    reasons += [LAWLESS] * (own > 1.0 - PROBLEM.min_explained_share)
    return {"undetermined": reasons} if reasons else {}


def is_material(chosen: HypothesisFit, holdout: HoldoutForecasts, least: float) -> bool:
    """Whether effects shrink the held-out gap by a share of at least ``least`` beyond what a refit does.

    The 95 % interval of the share must exclude zero. Effects on single samples show in no forecast and are
    material whenever they are probable.
    """
    share = holdout.beyond_refit
    assert share.value is not None
    assert share.low is not None
    return chosen.moves_samples or (share.value >= least and share.low > 0.0)


def is_open(over_floor: Interval) -> bool:
    """Whether an error is `VERDICT.open_gap` times its floor or more, and by no chance of the blocks."""
    assert over_floor.value is not None
    assert over_floor.low is not None
    return over_floor.value >= VERDICT.open_gap and over_floor.low > 1.0


def is_closed(over_floor: Interval) -> bool:
    """Whether an error is below `VERDICT.open_gap` times its floor."""
    assert over_floor.value is not None
    return over_floor.value < VERDICT.open_gap


def _describe_doubt(holdout: HoldoutForecasts) -> str:
    left, blocks = holdout.refit_over_floor, len(holdout.blocks)
    return (
        f"a refit leaves {left.value:.3g} times the expected error, but over {blocks} held-out stretches "
        f"that can be chance (95 % interval {left.low:.2g} to {left.high:.2g}): record longer"
    )


def is_within_tolerance(holdout: HoldoutForecasts) -> bool:
    """Whether the gap is open as the sim was given, and a refit within its tolerances closes it."""
    return is_open(holdout.given_over_floor) and is_closed(holdout.refit_over_floor)


def _measure_fits(sim: EstimatedSimulator, search: EffectSearch, judgement: Judgement) -> dict[str, Any]:
    """Mean square residuals [noise variances] and factors on the noise, as `Diagnosis.checks` lists them.

    Those of the sim are on its own recordings, now and before a recalibration.
    """

    problem, ranking = search.problem, search.ranking

    def measure(hypothesis: HypothesisFit) -> float:
        return hypothesis.fit.misfit / problem.degrees_of_freedom

    chain = [{"effects": [e.effect.name for e in fit.effects], "misfit": measure(fit)} for fit in search.sets]
    as_given = {"sim_misfit_as_given": sim.original.misfit} if sim.original else {}
    return {
        "sim_misfit": sim.misfit,
        **as_given,
        "misfit_none": measure(ranking.none),
        "misfit_best": measure(judgement.best or ranking.none),
        "chain": chain,
        "windows": len(problem.windows.first),
        "noise_inflation_of_ranking": ranking.noise_inflation,
        "noise_inflation": problem.noise_inflation,
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


def _list_candidates(
    problem: EstimationProblem,
    ranking: ModelRanking,
    judgement: Judgement,
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
            closure = holdout.estimate_closure(hypothesis)
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
