"""Whether what seems to come from outside could as well depend on the state of the mechanism.

A push at a given time explains anything that happens once. That it came from outside shows only where the
mechanism passes through the same state again and nothing happens; that a force is periodic, only where it
repeats.
"""

from collections.abc import Mapping

import numpy as np
from scipy.spatial import cKDTree

from lagsplat.diagnose.compare import Contest, Explained
from lagsplat.diagnose.effects.effect import Instance
from lagsplat.diagnose.effects.external_push import N_PUSHES
from lagsplat.diagnose.record import Record

ALIKE = 0.3
"""Distance between like states, in rms of the coordinate and of its velocity."""
APART = 0.25
"""Natural periods between a push and what counts as another passage."""
CYCLES = 4.0
"""Cycles from which on a periodic force is taken for one."""
FELT = 0.1
"""Share of the strongest push below which another is none."""


def repeated(one: Explained, contest: Contest) -> float:
    """How far the record shows that the exogenous effects of ``one`` come from outside, from 0 to 1.

    One where there are none of them.
    """
    record, shown = contest.bench.record, 1.0
    for instance in one.effects:
        if instance.effect.name in ("external_push", "external_periodic_force"):
            row = instance.physical(one.fit.x[None, one.own(instance)])[0]
            named = {p.name: float(v) for p, v in zip(instance.effect.parameters, row, strict=True)}
            seen = _lone(named, record, instance) if "time 0" in named else _cycles(named, record)
            shown = min(shown, seen)
    return shown


def _cycles(named: Mapping[str, float], record: Record) -> float:
    longest = max(record.time[stop - 1] - record.time[start] for start, stop in record.clips)
    return min(1.0, abs(named["angular_frequency"]) * longest / (2.0 * np.pi) / CYCLES)


def _lone(named: Mapping[str, float], record: Record, instance: Instance) -> float:
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
