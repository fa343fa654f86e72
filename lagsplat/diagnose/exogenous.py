"""Whether what seems to come from outside could as well depend on the state of the mechanism.

A push at a given time explains anything that happens once. That it came from outside shows only where the
mechanism passes through the same state again and nothing happens; that a force is periodic, only where it
repeats.
"""

from collections.abc import Mapping

import numpy as np
from scipy.spatial import cKDTree

from lagsplat.diagnose.compare import Contest, Explained
from lagsplat.diagnose.effects.external_push import N_PUSHES
from lagsplat.diagnose.record import Record

ALIKE = 0.2
"""Distance between like states, in rms of each coordinate and velocity, per square root of their number."""
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
    record, shown, at = contest.bench.record, 1.0, 0
    for instance in one.effects:
        size = len(instance.effect.parameters)
        if instance.effect.name in ("external_push", "external_periodic_force") and not one.noise:
            row = instance.physical(one.fit.x[None, at : at + size])[0]
            named = {p.name: float(v) for p, v in zip(instance.effect.parameters, row, strict=True)}
            shown = min(shown, _lone(named, record) if "time 0" in named else _cycles(named, record))
        at += size
    return shown


def _cycles(named: Mapping[str, float], record: Record) -> float:
    longest = max(record.time[stop - 1] - record.time[start] for start, stop in record.clips)
    return min(1.0, abs(named["angular_frequency"]) * longest / (2.0 * np.pi) / CYCLES)


def _lone(named: Mapping[str, float], record: Record) -> float:
    """Share of the pushed states that the record passes through without a push at another time, too."""
    strength = np.abs([named[f"acceleration {n}"] for n in range(N_PUSHES)])
    rms_q, rms_v = np.std(record.q, axis=0), np.maximum(np.std(record.v, axis=0), 1e-12)
    pause_s = APART * 2.0 * np.pi * float((rms_q / rms_v).min())
    pushed, free = np.zeros(len(record.time), dtype=bool), np.ones(len(record.time), dtype=bool)
    for n in np.flatnonzero(strength > FELT * strength.max()):
        off_s = np.abs(record.time - named[f"time {n}"]) - 0.5 * named[f"duration {n}"]
        pushed |= off_s <= record.dt_s
        free &= off_s > max(pause_s, record.dt_s)
    if not pushed.any() or not free.any():
        return 0.0
    state = np.concatenate([record.q / np.maximum(rms_q, 1e-12), record.v / rms_v], axis=1)
    apart, _ = cKDTree(state[free]).query(state[pushed])
    return float(np.mean(apart < ALIKE * np.sqrt(state.shape[1])))
