"""The energy of a learned law, along its own motion or along a motion that is only seen."""

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.chart.clock import Clock
from lagsplat.evaluate.protocol import STENCILS
from lagsplat.stage2.lagrangian import Lagrangian


@torch.no_grad()
def energy_of(
    lagrangian: Lagrangian, q: Float64[np.ndarray, "N d"], v: Float64[np.ndarray, "N d"]
) -> Float64[np.ndarray, " N"]:
    """``v.M v / 2 + V`` at states and velocities [1/s], in the law's own unit of energy."""
    states = torch.from_numpy(np.ascontiguousarray(q))
    w = torch.from_numpy(np.ascontiguousarray(v)) * float(lagrangian.time_unit_s)
    kinetic = 0.5 * torch.einsum("bi,bij,bj->b", w, lagrangian.mass(states), w)
    return (kinetic + lagrangian.potential(states)).numpy()


def energy_along(
    lagrangian: Lagrangian,
) -> Callable[[Float64[np.ndarray, "N d"], float], Float64[np.ndarray, " M"]]:
    """Energy along a series of evenly spaced states [s], with velocities by fourth-order differences.

    Two states at either end are left out, for their velocity would look beyond the series. Every model's
    motion is measured so, whatever it knows of its velocity.
    """

    def along(states: np.ndarray, dt_s: float) -> np.ndarray:
        inner = np.arange(2, len(states) - 2)
        speeds = Clock(dt_s).slope(states, inner, STENCILS["central"])
        return energy_of(lagrangian, states[inner], speeds)

    return along
