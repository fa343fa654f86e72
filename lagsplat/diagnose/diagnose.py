"""A diagnosis from end to end: a sim and real motions in, the verdict with all it rests on out."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lagsplat.diagnose.catalogue import instances
from lagsplat.diagnose.combine import combine
from lagsplat.diagnose.compare import Contest, Explained
from lagsplat.diagnose.config import DiagnoseConfig
from lagsplat.diagnose.effects.effect import UNITS, Instance, Noise
from lagsplat.diagnose.forecast import Held, close_alone, hold_out
from lagsplat.diagnose.hints import hints
from lagsplat.diagnose.result import Candidate, Diagnosis, Parameter
from lagsplat.diagnose.select import Effort, Ranking, rank
from lagsplat.diagnose.smoother import smooth
from lagsplat.diagnose.stand import Sim, stand
from lagsplat.diagnose.verdict import Judgement, interval, judge
from lagsplat.io.motion import Motion

OBVIOUS = 30.0
"""Nats beyond which an effect is named even if the forecasts hardly gain by it."""
CLOSED = 4
"""Candidates whose own closure is worked out."""


@dataclass(frozen=True)
class Found:
    """A diagnosis, with the bench it was made on and the fit it chose."""

    diagnosis: Diagnosis
    contest: Contest
    chosen: Explained


def diagnose(
    sim: Sim,
    real: Sequence[Motion],
    config: DiagnoseConfig,
    *,
    tell: Callable[[str], None] = lambda name: None,
) -> Found:
    """Why ``sim`` and the motions ``real`` disagree; ``tell`` hears the name of every effect that is tried.

    Raises:
        ValueError: the motions are too short for a single window.
    """
    contest, ready, natural = stand(sim, real, config)
    smoothed = smooth(sim.model, real, period_s=natural.longest_s, hold=config.input_hold)
    offers = instances(
        contest.bench,
        hints(smoothed, period_s=natural.longest_s),
        q_names=real[0].q_names,
        u_names=real[0].u_names,
        without=config.without,
    )
    effort = Effort(
        config.families,
        config.places,
        config.starts,
        tuple(config.always),
        config.temper,
        max(1.0, sim.misfit),
    )
    ranking = rank(contest, offers, effort, tell=tell)
    chain = combine(contest, ranking, offers, effort, config, tell=tell)
    judgement = judge(ranking, chain, contest.freedom, effort.nominal, config)
    best = judgement.best
    named = judgement.verdict == "effect" and best is not None
    chosen = best if named and best is not None else ranking.none
    held, warnings = _held(contest, ranking, chosen, natural.longest_s)
    if named and held is not None and best is not None and _immaterial(held, best, config):
        judgement = replace(judgement, verdict="none")
    diagnosis = Diagnosis(
        verdict=judgement.verdict,
        candidates=_candidates(contest, ranking, best, judgement, held, natural.longest_s),
        combination=tuple(e.effect.name for e in chosen.effects) if judgement.verdict == "effect" else (),
        gap=held.gap if held else None,
        where=None,
        equivalent=judgement.equivalent if named else (),
        excitation=(),
        warnings=tuple(warnings),
        absorbed=(),
        blocks=held.blocks if held else (),
        checks={
            "natural_period_s": natural.longest_s,
            "noise": ready.sigma.tolist(),
            "misfit_none": ranking.none.fit.misfit / contest.freedom,
            "misfit_best": (best or ranking.none).fit.misfit / contest.freedom,
            "unexplained": judgement.left,
            "chain": [
                {"effects": [e.effect.name for e in one.effects], "misfit": one.fit.misfit / contest.freedom}
                for one in chain
            ],
            "sim_misfit": sim.misfit,
            "windows": len(contest.windows.first),
            "temper": ranking.temper,
        },
        q_names=real[0].q_names,
        u_names=real[0].u_names,
    )
    return Found(diagnosis, contest, chosen)


def _held(
    contest: Contest, ranking: Ranking, chosen: Explained, period_s: float
) -> tuple[Held | None, list[str]]:
    try:
        return hold_out(contest, ranking.none, chosen, period_s=period_s), []
    except ValueError as error:
        return None, [f"no closure: {error}"]


def _immaterial(held: Held, best: Explained, config: DiagnoseConfig) -> bool:
    gap = held.gap
    return (
        best.log_evidence < OBVIOUS
        and gap.before - gap.after < config.materiality * gap.before
        and gap.before < 1.2 * gap.floor
    )


def _candidates(
    contest: Contest,
    ranking: Ranking,
    best: Explained | None,
    judgement: Judgement,
    held: Held | None,
    period_s: float,
) -> tuple[Candidate, ...]:
    fits: dict[str, tuple[Explained, Instance]] = {}
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
        near = number < CLOSED and held is not None and not isinstance(instance.effect, Noise)
        out.append(
            Candidate(
                name,
                probability,
                coordinate=instance.direction.name if instance.direction else None,
                input=instance.input_name,
                parameters=parameters(contest, one, instance, ranking.temper),
                closure=close_alone(contest, one, held, period_s=period_s) if near and held else None,
                log_evidence=one.log_evidence,
                misfit=one.fit.misfit / contest.freedom,
            )
        )
    return tuple(out)


def parameters(contest: Contest, one: Explained, instance: Instance, temper: float) -> dict[str, Parameter]:
    """The fitted parameters of one of the effects, with 90 % intervals, under their published keys."""
    effect, scales = instance.effect, instance.scales
    if isinstance(effect, Noise):
        spec = {p.name: p for p in effect.parameters}
        out = {}
        for name, values in one.noise.items():
            kind = spec[name].kind
            out[name] = Parameter(*(value * scales.of(kind) for value in values), UNITS[kind])
        return out
    known = [e for e in one.effects if not isinstance(e.effect, Noise)]
    prior = [p.prior for e in known for p in e.effect.parameters]
    low, high = interval(replace(one, effects=tuple(known)), contest.bench.nuisance.deviation, prior, temper)
    at = sum(len(e.effect.parameters) for e in known[: known.index(instance)])
    cut = slice(at, at + len(effect.parameters))
    rows = instance.physical(np.stack([one.fit.x[cut], low[cut], high[cut]]))
    values = [_told(instance, row) for row in rows]
    units = {p.name: UNITS[p.kind] for p in effect.parameters}
    fallback = UNITS[effect.parameters[0].kind]
    out = {}
    for key, value in values[0].items():
        ends = (
            sorted((values[1][key], values[2][key]))
            if not isinstance(value, list)
            else [values[1][key], values[2][key]]
        )
        out[key] = Parameter(value, ends[0], ends[1], units.get(key, fallback).format(
            q=instance.direction.name if instance.direction else "q", u=instance.input_name or "u"))  # fmt: skip
    return out


def _told(instance: Instance, row: np.ndarray) -> dict[str, Any]:
    effect = instance.effect
    plain = {
        p.name: float(np.exp(value) if p.kind == "log_ratio" else value)
        for p, value in zip(effect.parameters, row, strict=True)
    }
    return effect.reports(plain) if effect.reports is not None else plain
