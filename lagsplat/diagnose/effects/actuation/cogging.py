"""Cogging: a force that is periodic in the position.

Source: Islam, Mir and Sebastian, doi:10.1109/TIA.2004.827456.
"""

import math

from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal, log_normal
from lagsplat.diagnose.solvers.force_laws import compile_force_law


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Return ``cosine cos(wave_number s) + sine sin(wave_number s)``."""
    return theta[0] * math.cos(theta[2] * s) + theta[1] * math.sin(theta[2] * s)


EFFECT = ForceEffect(
    name="cogging",
    group="C",
    number=7,
    component="conservative",
    equation="a = acceleration cos(2 pi s / pitch + phase)",
    parameters=(
        EffectParameter("cosine", "acceleration", Normal(0.2)),
        EffectParameter("sine", "acceleration", Normal(0.2)),
        EffectParameter(
            "wave_number",
            "per_coordinate",
            log_normal(5.0, 0.8),
            (1.8, 2.4, 3.0, 3.7, 4.5, 5.4, 6.5, 8.0, 10.0, 12.5, 16.0),
        ),
    ),
    needs="slow motion through many places",
    law=force,
    report_parameters=lambda p, placed: {
        "acceleration": math.hypot(p["cosine"], p["sine"]),
        "pitch": 2.0 * math.pi / p["wave_number"],
    },
    report_units={"pitch": "{q}"},
    confusable_with=("cubic_stiffness", "joint_backlash"),
    flexible=True,
    mujoco="a joint has no force that is periodic in its position.",
    title="cogging of a motor",
    what="Magnets or teeth pull the mechanism into places at even distances, also without current.",
    symptom="Slow motion goes in ripples that lie at the same positions every time.",
    remedy="Add the ripple to the simulation, or compensate it in the drive.",
)
