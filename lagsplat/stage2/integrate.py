"""Velocity Verlet for a force that depends on the velocity."""

from lagsplat.shapes import Inputs, Latents
from lagsplat.stage2.lagrangian import Lagrangian, Prepared


def verlet_step(
    lagrangian: Lagrangian, q: Latents, v: Latents, u: Inputs, *, step: float, ready: Prepared
) -> tuple[Latents, Latents]:
    """One step of length ``step`` (internal time units), the input held.

    The second evaluation takes the half-step velocity, which keeps the order at two under damping.
    """
    half = v + (0.5 * step) * lagrangian.acceleration(q, v, u, ready=ready)
    q_next = q + step * half
    return q_next, half + (0.5 * step) * lagrangian.acceleration(q_next, half, u, ready=ready)
