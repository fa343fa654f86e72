"""Fit every effect, and take the one whose forecasts of the held-out half err least.

So friction models of servo motors are chosen, for instance (Duclusaud et al., 2024, arXiv:2410.08650). Fits
and forecasts are those of the diagnosis; its evidence, its priors over effects, its calibration and its
doubts about the sim are not used. Free to move, the sim's own parameters would take up most changes, and the
error of ``none`` would be the lowest.
"""

from dataclasses import replace

import numpy as np

from benchmarks.gap_baselines.case import Case
from benchmarks.gap_baselines.said import Said
from lagsplat.diagnose.core.config import HOLDOUT, DiagnoseConfig
from lagsplat.diagnose.core.result import Block
from lagsplat.diagnose.effects.base import PlacedEffect
from lagsplat.diagnose.estimation.dataset import WindowSet
from lagsplat.diagnose.identification.estimated_simulator import estimate_simulator
from lagsplat.diagnose.inference.holdout import Forecast, cut_blocks, forecast_blocks, split_windows
from lagsplat.diagnose.inference.model_selection import fit_candidate, score_test
from lagsplat.diagnose.inference.placement import extract_hints, place_effects
from lagsplat.diagnose.inference.problem import EstimationProblem, build_problem
from lagsplat.diagnose.residual.latent_force import estimate_latent_force


def lowest_error(case: Case, config: DiagnoseConfig) -> Said:
    """The effect, or ``none``, with the lowest mean square error over the held-out blocks.

    As probabilities stand likelihoods of the blocks, each counted once, under errors as large as the best's.

    Raises:
        ValueError: the motions are too short for a single window or block.
    """
    contest = build_problem(estimate_simulator(case.sim, config), case.real, config)
    bench = replace(contest.rollout_model, nuisance=contest.rollout_model.nuisance.freeze())
    contest = replace(contest, rollout_model=bench)
    half, held = split_windows(contest)
    blocks = cut_blocks(contest, held)
    offers = _offers(contest, case, config)
    fit = half.fit((), np.zeros(contest.rollout_model.nuisance.size))
    error, sims = (
        {"none": _error(contest, blocks, (), fit.x)},
        forecast_blocks(contest, blocks, (), 0.0 * fit.x),
    )
    place: dict[str, PlacedEffect] = {}
    told: dict[str, Forecast] = {}
    for lead in score_test(half, (), fit, offers):
        name = lead.placed.effect.name
        if name in place:
            continue  # its best place stands first
        place[name] = lead.placed
        x = fit_candidate(half, (), fit, lead, starts=1).fit.x
        told[name] = forecast_blocks(contest, blocks, (lead.placed,), x)
        error[name] = _square(contest, blocks, told[name])
    least = min(error.values())
    scores = {n: -0.5 * len(blocks.first) * np.log(e / least) for n, e in error.items() if np.isfinite(e)}
    total = sum(np.exp(list(scores.values())))
    probability = {name: float(np.exp(score) / total) for name, score in scores.items()}
    first = max(probability, key=lambda name: probability[name])
    if first == "none":
        return Said(probability, blocks=_blocks(contest, blocks, sims, sims))
    at = place[first]
    coordinate = at.direction.name if at.direction else None
    return Said(probability, coordinate, at.input_name, blocks=_blocks(contest, blocks, sims, told[first]))


def _offers(contest: EstimationProblem, case: Case, config: DiagnoseConfig) -> list[PlacedEffect]:
    smoothed = estimate_latent_force(
        contest.rollout_model.model, case.real, period_s=contest.period_s, hold=config.input_hold
    )
    return place_effects(
        contest.rollout_model,
        extract_hints(smoothed, period_s=contest.period_s),
        q_names=case.real[0].q_names,
        u_names=case.real[0].u_names,
        without=config.without,
    )


def _error(
    contest: EstimationProblem, blocks: WindowSet, effects: tuple[PlacedEffect, ...], x: np.ndarray
) -> float:
    return _square(contest, blocks, forecast_blocks(contest, blocks, effects, x))


def _square(contest: EstimationProblem, blocks: WindowSet, said: Forecast) -> float:
    """Mean square past the burn-in, in each coordinate's rms; infinite where a forecast escapes."""
    q = contest.rollout_model.dataset.q
    wrong = ((said.y - blocks.take(q)) / np.std(q, axis=0))[:, HOLDOUT.start_samples :]
    return float(np.mean(wrong**2)) if np.isfinite(wrong).all() else float("inf")


def _blocks(
    contest: EstimationProblem, blocks: WindowSet, sim: Forecast, augmented: Forecast
) -> tuple[Block, ...]:
    record = contest.rollout_model.dataset
    real = blocks.take(record.q)
    whole = []
    for k, (start, length) in enumerate(zip(blocks.first, blocks.length, strict=True)):
        clip = int(np.searchsorted(record.clips[:, 1], start, side="right"))
        time = record.time[start : start + length]
        one = Block(record.files[record.file_of[clip]], k, time, real[k], sim.y[k], augmented.y[k])
        whole.append(replace(one, **{n: getattr(one, n)[:length] for n in ("real", "sim", "augmented")}))
    return tuple(whole)
