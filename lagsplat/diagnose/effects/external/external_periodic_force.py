"""A vibration from outside: a periodic force at a frequency of its own, also while the mechanism rests.

Few machines shake like a pure sine, so it has a second harmonic.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from lagsplat.diagnose.core.config import RECURRENCE
from lagsplat.diagnose.effects.base import Effect, ForceEffect, PlacedEffect, PlaceFinder
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal, Scales, log_normal
from lagsplat.diagnose.solvers.force_laws import compile_force_law


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Return ``cosine cos(omega t) + sine sin(omega t)``, and the same at ``2 omega``."""
    c, s = math.cos(theta[4] * t), math.sin(theta[4] * t)
    return theta[0] * c + theta[1] * s + theta[2] * (c * c - s * s) + theta[3] * 2.0 * s * c


def limit_period(effect: Effect, scales: Scales) -> Effect:
    """The effect with a period of at most the length of the recording; a longer wave is a drift."""
    *amplitudes, frequency = effect.parameters
    slowest = math.log(2.0 * math.pi / scales.duration_s / scales.of("rate"))
    bounded = replace(frequency, prior=replace(frequency.prior, lowest=slowest))
    return replace(effect, parameters=(*amplitudes, bounded))


def place_at_lines(
    effect: ForceEffect, finder: PlaceFinder, lines_hz: Sequence[Sequence[float]]
) -> list[PlacedEffect]:
    """Along each coordinate that has spectral lines, of which the search first tries the frequencies [Hz]."""
    places = []
    for placed, lines in zip(finder.find_along_coordinates(effect), lines_hz, strict=True):
        grid = tuple((2.0 * np.pi * line / placed.scales.of("rate"),) for line in lines)
        if grid:
            places.append(replace(placed, effect=limit_period(effect, placed.scales), grid=grid))
    return places


def measure_recurrence(parameters: Mapping[str, float], dataset: Any, placed: PlacedEffect) -> float:
    """Number of cycles in the longest clip, as a share of those from which on a force counts as periodic."""
    longest_s = max(dataset.time[stop - 1] - dataset.time[start] for start, stop in dataset.clips)
    cycles = abs(parameters["angular_frequency"]) * longest_s / (2.0 * np.pi)
    return min(1.0, cycles / RECURRENCE.certain_cycles)


EFFECT = ForceEffect(
    name="external_periodic_force",
    group="E",
    number=3,
    component="exogenous",
    equation="a = acceleration cos(2 pi frequency t + phase) + harmonic cos(4 pi frequency t + phase_2)",
    parameters=(
        EffectParameter("cosine", "acceleration", Normal(0.2)),
        EffectParameter("sine", "acceleration", Normal(0.2)),
        EffectParameter("cosine_2", "acceleration", Normal(0.05)),
        EffectParameter("sine_2", "acceleration", Normal(0.05)),
        EffectParameter("angular_frequency", "rate", log_normal(1.0, 1.0), (0.5, 1.0, 1.5, 2.0, 3.0)),
    ),
    needs="a stretch at rest of ten cycles",
    place=lambda effect, finder: place_at_lines(effect, finder, [hint.lines_hz for hint in finder.hints]),
    law=force,
    report_parameters=lambda p, placed: {
        "frequency_hz": p["angular_frequency"] / (2.0 * math.pi),
        "acceleration": math.hypot(p["cosine"], p["sine"]),
        "harmonic": math.hypot(p["cosine_2"], p["sine_2"]),
    },
    confusable_with=("hidden_mode",),
    flexible=True,
    recurrence=measure_recurrence,
    mujoco="a force that depends on time is applied in the control loop (qfrc_applied), not in the model.",
    title="a vibration from outside",
    kind="outside",
    what="Something shakes the mechanism at a steady frequency, such as a motor or the floor.",
    symptom="One frequency stands out that no input explains, even at rest.",
    remedy="Find and stop its source, or add it to the simulation.",
)
