"""Velocity Verlet for a force that depends on the velocity."""

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
