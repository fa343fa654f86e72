"""A mass carried along: inertia and weight together.

Along a coordinate the inertia grows by ``mass_ratio m``. The weight follows: ``weight`` times as large a
share of what pulls at the coordinate already, and a constant part ``pull``. A point mass at the distance
``r`` of a pendulum of equivalent length ``l`` has ``weight = l / r``; on a horizontal slide it has none.
"""

from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.base import CoefficientBatch, ModelEffect, PlacedEffect
from lagsplat.diagnose.effects.inertia.armature import add_inertia
from lagsplat.diagnose.effects.parameters import EffectParameter, HalfNormal, Normal
from lagsplat.diagnose.mechanics.basis import POWER


def change(
    coefficients: CoefficientBatch, theta: Float64[np.ndarray, "P 3"], placed: PlacedEffect, model: Any
) -> CoefficientBatch:
    """Add inertia, and the share of the potential that depends on the coordinate alone, level at rest."""
    along = placed.direction
    assert along is not None
    i, n = int(np.argmax(np.abs(along.covector))), coefficients.potential.shape[1]
    order, kind = model.basis.order[:n], model.basis.kind[:n]
    own = (order[:, i] != 0) & (np.delete(order, i, axis=1) == 0).all(axis=1)
    linear = int(np.flatnonzero(own & (kind == POWER) & (order[:, i] == 1))[0])
    share = theta[:, 0] * theta[:, 1]
    potential, slopes = coefficients.potential.copy(), model.basis.slopes(model.rest[None])[0, :n, i]
    at_rest = potential[:, own] @ slopes[own]
    potential[:, own] *= 1.0 + share[:, None]
    pull = share * at_rest + theta[:, 0] * theta[:, 2] * along.inertia
    potential[:, linear] -= pull * model.basis.scale[i]
    return replace(add_inertia(coefficients, theta[:, 0], placed), potential=potential)


EFFECT = ModelEffect(
    name="payload",
    group="A",
    number=8,
    component="inertial",
    equation="M = M_sim + mass_ratio m, V = V_sim + mass_ratio (weight V_own - m pull s)",
    parameters=(
        EffectParameter("mass_ratio", "ratio", HalfNormal(0.3), label="added mass (share of the simulated)"),
        EffectParameter("weight", "ratio", HalfNormal(1.0), (0.01, 0.5, 1.0, 1.5)),
        EffectParameter("pull", "acceleration", Normal(2.0), (-2.0, 0.0, 2.0)),
    ),
    needs_all_forces=True,
    needs="a static hold and a motion, both under known inputs",
    change=change,
    confusable_with=("mass_change", "armature", "linear_stiffness", "constant_force"),
    mujoco="a generalised coordinate does not tell which body carries the mass, and where.",
    title="a payload",
    kind="parameter",
    what="The mechanism carries a mass that the simulation does not have: it adds inertia and weight.",
    symptom="It answers more slowly, and the same pose takes more force to hold.",
    remedy="Weigh the payload and give the simulation its mass where it is carried.",
)
