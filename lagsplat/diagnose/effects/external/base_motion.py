"""A base that is shaken: its acceleration acts on all coordinates at once, by their inertia.

The forces are in one phase and in fixed shares, which the force that the simulation lacks shows at the
frequency of its highest line. On a single coordinate this is a periodic force.
"""

from dataclasses import replace

import numpy as np

from lagsplat.diagnose.effects.base import Direction, ForceEffect, PlacedEffect, PlaceFinder
from lagsplat.diagnose.effects.external import external_periodic_force
from lagsplat.diagnose.effects.external.external_periodic_force import limit_period


def place(effect: ForceEffect, finder: PlaceFinder) -> list[PlacedEffect]:
    """Along the common direction of all coordinates at their highest line, where two or more share it."""
    shaken = [hint.shaking for hint in finder.hints if hint.shaking is not None]
    shares = np.array([share for _, share in shaken])
    if len(shares) < len(finder.coordinates) or np.count_nonzero(shares) < 2:
        return []
    most = finder.coordinates[int(np.argmax(np.abs(shares)))]
    forces = shares * [each.inertia for each in finder.coordinates] / (np.abs(shares).max() * most.inertia)
    common = Direction(None, forces, most.inertia)
    scales = finder.measure(most, "")
    grid = ((2.0 * np.pi * shaken[0][0] / scales.of("rate"),),)
    return [replace(PlacedEffect(limit_period(effect, scales), scales, "", common), grid=grid)]


EFFECT = replace(
    external_periodic_force.EFFECT,
    name="base_motion",
    number=6,
    equation="M a = ... - M r cos(2 pi frequency t + phase), and its harmonic, r a common direction of all",
    needs="two coordinates, and a stretch at rest of ten cycles",
    place=place,
    confusable_with=("external_periodic_force", "hidden_mode"),
    mujoco="the ground of a model stands still; it would need a base that is moved from outside.",
    title="a base that shakes",
    what="What the mechanism is fixed to moves to and fro, and every part feels it by its inertia.",
    symptom="All coordinates show one frequency in one phase that no input explains, even at rest.",
    remedy="Fasten the base, or log its acceleration and give it to the simulation as an input.",
)
