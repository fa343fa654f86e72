"""Viscous damping that differs from the simulation's: ``Q = -rate m v``, real minus simulated."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.base import CoefficientBatch, ForceEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal
from lagsplat.diagnose.solvers.force_laws import compile_force_law


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Return ``-rate v``."""
    return -theta[0] * v


def add_damping(
    coefficients: CoefficientBatch, theta: Float64[np.ndarray, "P 1"], model: Any
) -> CoefficientBatch:
    """Add damping in proportion to the inertia at rest."""
    damping = coefficients.damping.copy()
    damping[:, 0] += theta[:, :1, None] * model.inertia
    return replace(coefficients, damping=damping)


def to_mujoco(element: Any, values: Mapping[str, Any]) -> tuple[str, ...]:
    """Raise the linear damping of the joint."""
    return element.raise_damping(0, values["rate"])


EFFECT = ForceEffect(
    name="viscous_damping",
    group="A",
    number=1,
    component="dissipative",
    equation="a = -rate v",
    parameters=(EffectParameter("rate", "rate", Normal(0.2), label="rate (real minus simulated)"),),
    needs="ring-downs at two amplitudes",
    along="both",
    acts_everywhere=True,
    between_variants=("",),
    law=force,
    whole=add_damping,
    confusable_with=("mass_change", "linear_stiffness", "input_gain", "creep", "quadratic_drag"),
    mujoco=to_mujoco,
    title="another viscous damping than the simulation's",
    kind="parameter",
    what="A resistance in proportion to speed is stronger or weaker than in the simulation.",
    symptom="Swings die away faster or slower than predicted, by the same share at every size.",
    remedy="Set the simulation's damping anew.",
)
