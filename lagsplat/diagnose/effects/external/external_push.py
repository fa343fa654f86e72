"""Pushes that were not logged: a constant force for a while, up to three times."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from lagsplat.diagnose.core.config import RECURRENCE
from lagsplat.diagnose.effects.base import ForceEffect, PlacedEffect, PlaceFinder
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal, log_normal
from lagsplat.diagnose.solvers.force_laws import compile_force_law

N_PUSHES = 3  # most pushes in one recording; the law below is compiled for as many


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Return the sum of pushes, each half a ``duration`` to both sides of its ``time``, with smooth edges."""
    total = 0.0
    for n in range(3):
        x = (0.5 * theta[6 + n] - abs(t - theta[3 + n])) / theta[9]
        if x > -30.0:
            total += theta[n] / (1.0 + math.exp(-x))
    return total


def report_pushes(parameters: Mapping[str, float], placed: PlacedEffect) -> dict[str, Any]:
    """Times and accelerations of all pushes above a tenth of the strongest, in the order of time."""
    strongest = max(abs(parameters[f"acceleration {n}"]) for n in range(N_PUSHES))
    rows = sorted(
        (parameters[f"time {n}"], parameters[f"acceleration {n}"])
        for n in range(N_PUSHES)
        if abs(parameters[f"acceleration {n}"]) > 0.1 * strongest
    )
    return {"times": [time for time, _ in rows], "accelerations": [a for _, a in rows]}


def place(effect: ForceEffect, finder: PlaceFinder) -> list[PlacedEffect]:
    """Along each coordinate, with the strongest pushes of the force that the simulation lacks.

    The search first tries them together, each as long as its event, and half as long.
    """
    places = []
    for placed, hints in zip(finder.find_along_coordinates(effect), finder.hints, strict=True):
        unit, frame_s, pushes = placed.scales.of("time"), placed.scales.frame_s, hints.pushes[:N_PUSHES]
        absent = N_PUSHES - len(pushes)
        middle = [0.5 * (start + end) / unit for start, end in pushes]
        grid = []
        for share in (1.0, 0.5):
            lasts = [share * max(end - start, frame_s) / unit for start, end in pushes]
            # a push that is not needed is put where no window is
            grid.append((*middle, *[-1e3] * absent, *lasts, *[1.0] * absent))
        if pushes:
            places.append(replace(placed, grid=tuple(grid)))
    return places


def measure_recurrence(parameters: Mapping[str, float], dataset: Any, placed: PlacedEffect) -> float:
    """Share of the pushed states that the recording also passes through without a push, at another time.

    Only the pushed coordinate counts: several coordinates together hardly ever come back.
    """
    assert placed.direction is not None
    strength = np.abs([parameters[f"acceleration {n}"] for n in range(N_PUSHES)])
    s, v = dataset.q @ placed.direction.covector, dataset.v @ placed.direction.covector
    rms_s, rms_v = max(float(np.std(s)), 1e-12), max(float(np.std(v)), 1e-12)
    pause_s = RECURRENCE.passage_periods * 2.0 * np.pi * rms_s / rms_v
    pushed, free = np.zeros(len(dataset.time), dtype=bool), np.ones(len(dataset.time), dtype=bool)
    for n in np.flatnonzero(strength > RECURRENCE.min_push_share * strength.max()):
        off_s = np.abs(dataset.time - parameters[f"time {n}"]) - 0.5 * parameters[f"duration {n}"]
        pushed |= off_s <= dataset.dt_s
        free &= off_s > max(pause_s, dataset.dt_s)
    if not pushed.any() or not free.any():
        return 0.0
    state = np.stack([s / rms_s, v / rms_v], axis=1)
    distance, _ = cKDTree(state[free]).query(state[pushed])
    return float(np.mean(distance < RECURRENCE.state_distance))


EFFECT = ForceEffect(
    name="external_push",
    group="E",
    number=2,
    component="exogenous",
    equation="a = acceleration for a duration about a time, up to three times",
    parameters=(
        *(EffectParameter(f"acceleration {n}", "acceleration", Normal(1.0)) for n in range(N_PUSHES)),
        *(EffectParameter(f"time {n}", "time", Normal(1000.0), (1.0,)) for n in range(N_PUSHES)),
        *(EffectParameter(f"duration {n}", "time", log_normal(1.0, 0.8), (1.0,)) for n in range(N_PUSHES)),
    ),
    needs="a stretch in which nothing else moves it",
    place=place,
    law=force,
    constants=lambda scales, variant: (scales.frame_s,),
    report_parameters=report_pushes,
    flexible=True,
    recurrence=measure_recurrence,
    mujoco="it belongs to one recording and is applied in the control loop (xfrc_applied), not in the model.",
    title="a push that nobody logged",
    kind="outside",
    what="Something or somebody touched the mechanism for a moment.",
    symptom="The forecast is right before and after, and wrong across one instant.",
    remedy="Leave that stretch out, or give the push to the simulation as an input.",
)
