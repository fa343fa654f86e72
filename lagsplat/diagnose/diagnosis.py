"""A diagnosis from end to end: a sim and real motions in, the verdict with all it rests on out."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

from lagsplat.diagnose.core.config import DiagnoseConfig
from lagsplat.diagnose.core.result import Candidate, Diagnosis
from lagsplat.diagnose.effects.base import PlacedEffect, SampleEffect
from lagsplat.diagnose.identification.estimated_simulator import EstimatedSimulator
from lagsplat.diagnose.inference.evidence import HypothesisFit
from lagsplat.diagnose.inference.holdout import HoldoutForecasts, estimate_single_closure, forecast_holdout
from lagsplat.diagnose.inference.model_selection import ModelRanking, SearchBudget, rank_hypotheses
from lagsplat.diagnose.inference.placement import find_hints, place_effects
from lagsplat.diagnose.inference.plausibility import assess_implausibility
from lagsplat.diagnose.inference.posterior import (
    Judgement,
    combine_effects,
    judge_hypotheses,
    motionless_misfit,
    reject_effect,
)
from lagsplat.diagnose.inference.problem import EstimationProblem, build_problem
from lagsplat.diagnose.inference.profile_likelihood import estimate_parameters
from lagsplat.diagnose.inference.robustness import check_robustness, inflate_noise
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.io.trajectory.trajectory import Trajectory

OBVIOUS = 30.0
"""Nats beyond which an effect is named even if the forecasts hardly gain by it."""
CLOSE = 1.5
"""Forecasts that are off by so many times what noise leaves, at most, may go without a cause."""
TOLD = 0.5
"""Mean square, in that of the noise, below which a sim tells a recording of less noise than is assumed."""
CLOSED = 4
"""Candidates whose own closure is worked out."""


@dataclass(frozen=True)
class DiagnosisRun:
    """A diagnosis, with the bench it was made on, all that was fitted and the fit it chose."""

    diagnosis: Diagnosis
    contest: EstimationProblem
    ranking: ModelRanking
    chosen: HypothesisFit


def diagnose(
    sim: EstimatedSimulator,
    real: Sequence[Trajectory],
    config: DiagnoseConfig,
    *,
    null: float = 0.0,
    tell: Callable[[str], None] = lambda name: None,
) -> DiagnosisRun:
    """Why ``sim`` and the motions ``real`` disagree; ``tell`` hears the name of every effect that is tried.

    ``null`` is what effects gain by the sim's own errors [nat], and must gain more (`null_evidence`).

    Raises:
        ValueError: the motions are too short for a single window.
    """
    contest, ready, natural = build_problem(sim, real, config)
    hints = find_hints(sim.model, real, period_s=natural.longest_s, hold=config.input_hold)
    q_names, u_names = real[0].q_names, real[0].u_names
    offers = place_effects(
        contest.rollout_model, hints, q_names=q_names, u_names=u_names, without=config.without
    )
    effort = SearchBudget.of(config, nominal=max(1.0, sim.misfit), null=null)
    ranking, chain = _search_effects(contest, offers, effort, config, tell)
    wider = inflate_noise(contest, effort, chain[-1] if chain else ranking.none)
    if wider is not None:
        contest, effort = wider
        ranking, chain = _search_effects(contest, offers, effort, config, tell)
    doubts = partial(assess_implausibility, contest, ranking, nominal=effort.nominal)
    judgement = judge_hypotheses(
        ranking,
        chain,
        contest.uncertainty_directions,
        effort.nominal,
        config,
        most=motionless_misfit(contest),
        doubt=doubts,
    )
    best = judgement.best
    chosen = best if best is not None and judgement.verdict == "effect" else ranking.none
    held, warnings = _forecast_holdout(
        contest, ranking, chosen, natural.longest_s, (sim.original or sim).model
    )
    bare = ranking.none.fit.misfit / contest.uncertainty_directions
    if held is not None and chosen is best and best is not None and _is_immaterial(held, best, bare, config):
        judgement, chosen = reject_effect(judgement), ranking.none
    told = {
        "natural_period_s": natural.longest_s,
        "noise": ready.sigma.tolist(),
        "sim_misfit": sim.misfit,
        **({} if sim.original is None else {"sim_misfit_as_given": sim.original.misfit}),
        **_fit_measures(contest, ranking, chain, judgement),
        **asdict(check_robustness(contest, ranking, chain, judgement, offers, effort, config)),
    }
    diagnosis = Diagnosis(
        verdict=judgement.verdict,
        candidates=_list_candidates(contest, ranking, best, judgement, held, natural.longest_s),
        combination=tuple(e.effect.name for e in chosen.effects),
        gap=held.gap if held else None,
        where=None,
        equivalent=judgement.equivalent if chosen.effects else (),
        excitation=(),
        warnings=(*warnings, *_excluded_windows_warning(contest)),
        absorbed=(),
        blocks=held.blocks if held else (),
        checks=told,
        q_names=q_names,
        u_names=u_names,
    )
    return DiagnosisRun(diagnosis, contest, ranking, chosen)


def _search_effects(
    contest: EstimationProblem,
    offers: Sequence[PlacedEffect],
    effort: SearchBudget,
    config: DiagnoseConfig,
    tell: Callable[[str], None],
) -> tuple[ModelRanking, tuple[HypothesisFit, ...]]:
    """Every single effect, and the best sets of one to three."""
    ranking = rank_hypotheses(contest, offers, effort, tell=tell)
    return ranking, combine_effects(contest, ranking, offers, effort, config, tell=tell)


def _fit_measures(
    contest: EstimationProblem, ranking: ModelRanking, chain: Sequence[HypothesisFit], judgement: Judgement
) -> dict[str, Any]:
    """How well each explanation fits: mean square residuals in units of the noise."""
    best = judgement.best or ranking.none
    return {
        "misfit_none": ranking.none.fit.misfit / contest.uncertainty_directions,
        "misfit_best": best.fit.misfit / contest.uncertainty_directions,
        "unexplained": judgement.left,
        "doubt": judgement.doubted,
        "chain": [
            {
                "effects": [e.effect.name for e in one.effects],
                "misfit": one.fit.misfit / contest.uncertainty_directions,
            }
            for one in chain
        ],
        "windows": len(contest.windows.first),
        "temper": ranking.temper,
        "price": contest.price,
    }


def _forecast_holdout(
    contest: EstimationProblem,
    ranking: ModelRanking,
    chosen: HypothesisFit,
    period_s: float,
    given: MechanicalModel,
) -> tuple[HoldoutForecasts | None, list[str]]:
    try:
        return forecast_holdout(contest, ranking.none, chosen, period_s=period_s, given=given), []
    except ValueError as error:
        return None, [f"no closure: {error}"]


def _excluded_windows_warning(contest: EstimationProblem) -> list[str]:
    """What is said of stretches that the sim cannot know."""
    if not contest.aside:
        return []
    share = contest.aside / (contest.aside + len(contest.windows.first))
    return [
        f"{100.0 * share:.2g} % of the recording was left aside: there it is driven, or moves, as the sim's "
        "own recordings nowhere do (a sudden release, say), and what the sim foretells of it is chance"
    ]


def _is_immaterial(
    held: HoldoutForecasts, best: HypothesisFit, misfit: float, config: DiagnoseConfig
) -> bool:
    """Whether what ``best`` takes away is too little of the motion; ``misfit`` is what no effect leaves."""
    gap = held.gap
    if misfit < TOLD and gap.before <= gap.floor:
        return True
    return (
        best.log_evidence < OBVIOUS
        and gap.before - gap.after < config.materiality * gap.before
        and gap.before < CLOSE * gap.floor
    )


def _list_candidates(
    contest: EstimationProblem,
    ranking: ModelRanking,
    best: HypothesisFit | None,
    judgement: Judgement,
    held: HoldoutForecasts | None,
    period_s: float,
) -> tuple[Candidate, ...]:
    fits: dict[str, tuple[HypothesisFit, PlacedEffect]] = {}
    for one in ranking.found:
        fits.setdefault(one.effects[-1].effect.name, (one, one.effects[-1]))
    if best is not None:
        for instance in best.effects:
            fits[instance.effect.name] = (best, instance)
    out = []
    for number, (name, probability) in enumerate(judgement.probabilities.items()):
        if name not in fits:
            out.append(Candidate(name, probability))
            continue
        one, instance = fits[name]
        near = number < CLOSED and held is not None and not isinstance(instance.effect, SampleEffect)
        out.append(
            Candidate(
                name,
                probability,
                coordinate=instance.direction.name if instance.direction else None,
                input=instance.input_name,
                places=tuple(str(part.place) for part in instance.parts),
                parameters=estimate_parameters(contest, one, instance, ranking.temper),
                closure=estimate_single_closure(contest, one, held, period_s=period_s)
                if near and held
                else None,
                log_evidence=one.log_evidence,
                misfit=one.fit.misfit / contest.uncertainty_directions,
            )
        )
    return tuple(out)
