"""Velocity Verlet for a force that depends on the velocity."""

from lagsplat.shapes import Inputs, Latents
from lagsplat.stage2.lagrangian import Lagrangian, Prepared


def verlet_step(
    lagrangian: Lagrangian, q: Latents, v: Latents, u: Inputs, *, step: float, ready: Prepared
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
