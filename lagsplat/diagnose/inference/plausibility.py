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

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.spatial import cKDTree

from lagsplat.diagnose.effects.actuation.external_push import N_PUSHES
from lagsplat.diagnose.effects.base import PlacedEffect, SampleEffect
from lagsplat.diagnose.estimation.dataset import Dataset
from lagsplat.diagnose.inference.evidence import HypothesisFit, log_evidence
from lagsplat.diagnose.inference.model_selection import ModelRanking
from lagsplat.diagnose.inference.problem import EstimationProblem

UNSHOWN = 0.7
"""P(unknown) where nothing shows that what is named for an outer force comes from outside."""
SHAPELESS = ("external_push", "external_periodic_force", "hidden_mode", "creep")
"""Effects with times, frequencies or states of their own, of which two together fit most of anything."""
FITTING = 0.6
"""P(unknown) where two of these are needed."""
AHEAD, SCATTER = 0.0, 2.0
"""Nats ahead of the explanation at which a sim with loose parameters is as credible, and their scatter."""


@dataclass(frozen=True)
class Implausibility:
    """P(unknown), at the least, for one reason.

    ``unrepeated``: an outer force in states that the record passes only with it. ``shapeless``: several
    effects that fit anything. ``loose``: the sim's own parameters, all moved, are more evident.
    """

    chance: float
    why: Literal["unrepeated", "shapeless", "loose"]


def assess_implausibility(
    contest: EstimationProblem, ranking: ModelRanking, one: HypothesisFit, *, nominal: float
) -> Implausibility:
    """The strongest doubt in ``one``, if it explains the gap; none in what only moves single samples."""
    if any(isinstance(instance.effect, SampleEffect) for instance in one.effects):
        return Implausibility(0.0, "loose")
    ahead = relaxed_model_log_evidence(contest, ranking.none, one, nominal=nominal, temper=ranking.temper)
    loose = 1.0 / (1.0 + np.exp(np.clip((AHEAD - ahead) / SCATTER, -50.0, 50.0)))
    shapes = sum(instance.effect.name in SHAPELESS for instance in one.effects)
    reasons = (
        Implausibility(UNSHOWN * (1.0 - recurrence(one, contest)), "unrepeated"),
        Implausibility(FITTING if shapes > 1 else 0.0, "shapeless"),
        Implausibility(float(loose), "loose"),
    )
    return max(reasons, key=lambda reason: reason.chance)


ALIKE = 0.3
"""Distance between like states, in rms of the coordinate and of its velocity."""
APART = 0.25
"""Natural periods between a push and what counts as another passage."""
CYCLES = 4.0
"""Cycles from which on a periodic force is taken for one."""
FELT = 0.1
"""Share of the strongest push below which another is none."""


def recurrence(one: HypothesisFit, contest: EstimationProblem) -> float:
    """How far the record shows that the exogenous effects of ``one`` come from outside, from 0 to 1.

    One where there are none of them.
    """
    record, shown = contest.rollout_model.record, 1.0
    for instance in one.effects:
        if instance.effect.name in ("external_push", "external_periodic_force"):
            row = instance.physical(one.fit.x[None, one.own(instance)])[0]
            named = {p.name: float(v) for p, v in zip(instance.effect.parameters, row, strict=True)}
            seen = (
                _push_recurrence(named, record, instance)
                if "time 0" in named
                else _cycle_recurrence(named, record)
            )
            shown = min(shown, seen)
    return shown


def _cycle_recurrence(named: Mapping[str, float], record: Dataset) -> float:
    longest = max(record.time[stop - 1] - record.time[start] for start, stop in record.clips)
    return min(1.0, abs(named["angular_frequency"]) * longest / (2.0 * np.pi) / CYCLES)


def _push_recurrence(named: Mapping[str, float], record: Dataset, instance: PlacedEffect) -> float:
    """Share of the pushed states that the record passes through without a push at another time, too.

    Of several coordinates the one that is pushed: all of them together hardly ever come back.
    """
    assert instance.direction is not None
    strength = np.abs([named[f"acceleration {n}"] for n in range(N_PUSHES)])
    s, v = record.q @ instance.direction.covector, record.v @ instance.direction.covector
    rms_s, rms_v = max(float(np.std(s)), 1e-12), max(float(np.std(v)), 1e-12)
    pause_s = APART * 2.0 * np.pi * rms_s / rms_v
    pushed, free = np.zeros(len(record.time), dtype=bool), np.ones(len(record.time), dtype=bool)
    for n in np.flatnonzero(strength > FELT * strength.max()):
        off_s = np.abs(record.time - named[f"time {n}"]) - 0.5 * named[f"duration {n}"]
        pushed |= off_s <= record.dt_s
        free &= off_s > max(pause_s, record.dt_s)
    if not pushed.any() or not free.any():
        return 0.0
    state = np.stack([s / rms_s, v / rms_v], axis=1)
    apart, _ = cKDTree(state[free]).query(state[pushed])
    return float(np.mean(apart < ALIKE))


LOOSE = 60.0
"""How much looser: what is known to parts in a thousand may then be off by tens of per cent."""
BELIEVED = 1.5
"""Mean square residual on its own recordings, in that of the noise, up to which a sim can be believed."""
WORSE = 0.05
"""Mean square residual, in that of the noise, by which the loose sim may be worse and still explain all."""


def relaxed_model_log_evidence(
    contest: EstimationProblem, none: HypothesisFit, best: HypothesisFit, *, nominal: float, temper: float
) -> float:
    """Nats by which the loosened sim is more evident than ``best``; minus infinity if it explains less.

    So it is where the sim misses even its own recordings: then to explain the rest is no achievement.
    """
    if nominal > BELIEVED:
        return -np.inf
    bench = contest.rollout_model
    loose = replace(contest, rollout_model=replace(bench, nuisance=bench.nuisance.scale_mechanics(LOOSE)))
    fit = loose.fit((), none.fit.x, none.fit.starts)
    noise = nominal * contest.uncertainty_directions
    if fit.misfit > max(best.fit.misfit, noise) + WORSE * noise:
        return -np.inf
    there = log_evidence(HypothesisFit((), fit), loose.rollout_model, temper)
    return there - log_evidence(best, bench, temper)
