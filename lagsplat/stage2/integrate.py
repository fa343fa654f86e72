"""Velocity Verlet for a force that depends on the velocity."""

import math

from jaxtyping import Float
from torch import Tensor

from lagsplat.shapes import Inputs, Latents
from lagsplat.stage2.lagrangian import Lagrangian, Prepared

Step = float | Float[Tensor, "#B 1"] | Float[Tensor, "1"]
"""Length of one step (internal time units): the same for all samples, or each its own."""
Steps = float | Float[Tensor, "*B n"]
"""Lengths of the steps of a rollout: one number, one a step, or one a sample and step."""


def step_of(steps: Steps, i: int) -> Step:
    """Length of step ``i``."""
    return steps[..., i, None] if isinstance(steps, Tensor) else steps


def pieces_of(step: Step, longest: float) -> int:
    """Into how many equal pieces no longer than ``longest`` a step is divided, the same for all samples."""
    length = float(step.max()) if isinstance(step, Tensor) else step
    return max(1, math.ceil(length / longest - 1e-9))


def advance(
    lagrangian: Lagrangian, q: Latents, v: Latents, u: Inputs, *, step: Step, ready: Prepared
) -> tuple[Latents, Latents]:
    """From one frame to the next, ``step`` later, the input held: as many Verlet steps as it takes.

    An explicit step of length h turns a frequency w into ``w (1 + (w h)^2 / 24)``. Where frames are far apart
    the law would make up for that, and be wrong by as much, hence `Lagrangian.longest_step`.
    """
    pieces = pieces_of(step, lagrangian.longest_step)
    for _ in range(pieces):
        q, v = verlet_step(lagrangian, q, v, u, step=step / pieces, ready=ready)
    return q, v


def verlet_step(
    lagrangian: Lagrangian, q: Latents, v: Latents, u: Inputs, *, step: Step, ready: Prepared
) -> tuple[Latents, Latents]:
    """One step of length ``step`` (internal time units), the input held; of order two.

    The second evaluation takes the velocity predicted for the end of the step. The half-step velocity that
    is often used there averages damping at a quarter of the step, which is of order one only.
    """
    a = lagrangian.acceleration(q, v, u, ready=ready)
    half = v + (0.5 * step) * a
    q_next = q + step * half
    a_next = lagrangian.acceleration(q_next, half + (0.5 * step) * a, u, ready=ready)
    return q_next, half + (0.5 * step) * a_next
