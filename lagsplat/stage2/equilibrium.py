"""Equilibria of a law under constant inputs, the minima of ``V - u.nu``, and the modes about them."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor

from lagsplat.array_types import Inputs, Latent, Latents, Spd
from lagsplat.monomials import ROOM, draw_states
from lagsplat.stage2.lagrangian import Lagrangian, PreparedCoefficients
from lagsplat.stage2.polynomials import LONGEST_NEWTON_STEP

ITERATIONS = 200
TOLERANCE = 1e-10  # largest remaining force, relative to force plus stiffness at the start
LEAST_CURVATURE = 1e-6  # smallest curvature in a Newton step, relative to the largest
DECREASE = 1e-4  # Armijo's constant: share of the predicted decrease that a step must reach
UNRESOLVED = 1e-12  # predicted decrease, relative to 1 plus the energy, that rounding hides: a step is taken
SHORTEST = 2.0**-40  # smallest factor on a Newton step
STARTS = 64  # of the search for all equilibria, spread over the ball and the room around it
STEPS = 60  # of it
SAME_EQUILIBRIUM = 1e-2  # [whitened units]


class NoEquilibriumError(ValueError):
    """The search for an equilibrium of a law ended at none; the message says where."""


@torch.no_grad()
def find_equilibria(law: Lagrangian, inputs: Inputs, start: Latent | Latents | None = None) -> Latents:
    """Find an equilibrium (B, d) under each of some constant inputs.

    Newton's method on the energy. Where its Hessian is not positive definite, eigenvalues are replaced by
    their absolute value, so that every step descends; a step is halved until the energy falls by Armijo's
    rule. Where the quadratic floor of ``V`` outgrows all else far away, level sets of the energy are compact
    and every limit point is stationary.

    Args:
        law: the law, with a load if it is a `lagsplat.forces.loaded_lagrangian.LoadedLagrangian`.
        inputs: one row for each search, in the units of the recording.
        start: first state of all searches or of each; by default the law's rest state.

    Raises:
        NoEquilibriumError: energies overflow, or the iterations do not suffice.

    Source: paper, Appendix "Bounded forced response"; Nocedal and Wright, Numerical Optimization, ch. 3.
    """
    first = law.rest.detach() if start is None else start
    q = first.expand(len(inputs), -1).clone()
    ready = law.prepare()
    force, hessian = _differentiate(law, q, inputs, ready)
    scale = force.norm(dim=1) + hessian.abs().amax((1, 2))
    for _ in range(ITERATIONS if bool(torch.isfinite(scale).all()) else 0):
        moving = ~(force.norm(dim=1) <= TOLERANCE * scale)  # true for NaN, too
        if not bool(moving.any()):
            # One more Newton step where it lowers the force: responses are small differences of equilibria.
            closer = q + torch.linalg.solve_ex(hessian, force[:, :, None])[0][:, :, 0]
            remaining = law.conservative_force(closer, inputs, ready).norm(dim=1)
            return torch.where((remaining < force.norm(dim=1))[:, None], closer, q)
        q = torch.where(moving[:, None], _descend(law, q, inputs, force, hessian), q)
        force, hessian = _differentiate(law, q, inputs, ready)
    left = force.norm(dim=1) / scale
    worst = int(left.nan_to_num(torch.inf).argmax())
    raise NoEquilibriumError(
        f"no equilibrium was reached in {ITERATIONS} steps under the inputs {inputs[worst].tolist()}: "
        f"{float(left[worst]):.1e} of the force is left at q = {q[worst].tolist()}; lower the force or the "
        "inputs, or look at the law's potential"
    )


def find_equilibrium(
    law: Lagrangian, u: Float[Tensor, " n_u"] | None = None, start: Latent | None = None
) -> Latent:
    """Find the equilibrium under one constant input, by default none at all; as `find_equilibria`."""
    u = torch.zeros(law.n_inputs, dtype=torch.float64) if u is None else u
    return find_equilibria(law, u[None], start)[0]


def move_rest_to_equilibrium(law: Lagrangian) -> None:
    """Set the rest state of a polynomial law to its equilibrium; errors as `find_equilibria`."""
    rest = find_equilibrium(law)
    with torch.no_grad():
        law.rest.copy_(rest)


def compute_loaded_energy(law: Lagrangian, q: Latents, u: Inputs) -> Float[Tensor, " B"]:
    """``V - u.nu``, less the work of the load if there is one."""
    return law.potential(q) - (law.volume(q, u) * u).sum(1)


def compute_static_stiffness(law: Lagrangian, q: Latents, u: Inputs) -> Float[Tensor, "B d d"]:
    """The symmetric Hessian of the energy at ``q``."""
    return _differentiate(law, q, u, law.prepare())[1]


def _differentiate(
    law: Lagrangian, q: Latents, u: Inputs, ready: PreparedCoefficients
) -> tuple[Latents, Spd]:
    """The force at ``q`` and the symmetric Hessian of the energy."""
    with torch.enable_grad():
        point = q.detach().requires_grad_()
        force = law.conservative_force(point, u, ready)
        rows = [torch.autograd.grad(part.sum(), point, retain_graph=True)[0] for part in force.unbind(1)]
    hessian = -torch.stack(rows, 1).detach()
    return force.detach(), 0.5 * (hessian + hessian.mT)


def _descend(law: Lagrangian, q: Latents, u: Inputs, force: Latents, hessian: Spd) -> Latents:
    values, vectors = torch.linalg.eigh(hessian.nan_to_num())
    size = values.abs()
    size = size.clamp(min=LEAST_CURVATURE * size.amax(1, keepdim=True).clamp(min=1e-300))
    step = (vectors @ ((vectors.mT @ force[:, :, None])[:, :, 0] / size)[:, :, None])[:, :, 0]
    gain = (step * force).sum(1)
    before = compute_loaded_energy(law, q, u)
    fine = gain <= UNRESOLVED * (1.0 + before.abs())
    length = torch.ones_like(gain)
    while True:
        after = compute_loaded_energy(law, q + length[:, None] * step, u)
        falls: Bool[Tensor, " B"] = fine | (after <= before - DECREASE * length * gain)
        if bool(falls.all()) or float(length.min()) < SHORTEST:
            return torch.where(falls[:, None], q + length[:, None] * step, q)
        length = torch.where(falls, length, 0.5 * length)


@torch.no_grad()
def list_stable_equilibria(lagrangian: Lagrangian, inputs: Inputs) -> list[Float[Tensor, "n d"]]:
    """List the stable equilibria of a polynomial law under each of some constant inputs.

    Newton steps of bounded length, uphill directions turned, from starts spread over the ball in which the
    polynomials are free. A narrow basin between the starts can be missed.

    Args:
        lagrangian: a law with ``form.terms='polynomial'``.
        inputs: one row for each search.
    """
    energy, coordinates = lagrangian.energy, lagrangian.coordinates
    assert energy is not None
    assert coordinates is not None
    q = draw_states(energy.ball, STARTS, reach=1.0 + ROOM, seed=0).repeat(len(inputs), 1)
    u = inputs.repeat_interleave(STARTS, 0)
    for _ in range(STEPS):
        slope, stiffness = energy.differentiate(q, u)
        values, vectors = torch.linalg.eigh(stiffness)
        along = (vectors.mT @ slope[:, :, None])[:, :, 0] / values.abs().clamp(min=1e-6)
        step = (vectors @ along[:, :, None])[:, :, 0]
        q = q - step * (LONGEST_NEWTON_STEP / step.norm(dim=1, keepdim=True).clamp(min=LONGEST_NEWTON_STEP))
    settled = (step.norm(dim=1) < 0.1 * SAME_EQUILIBRIUM) & (values[:, 0] > 0.0)
    found = []
    for rows, ends in zip(q.split(STARTS), settled.split(STARTS), strict=True):
        distinct: list[Tensor] = []
        for row in rows[ends]:
            if all(float((row - other).norm()) > SAME_EQUILIBRIUM for other in distinct):
                distinct.append(row)
        found.append(coordinates.invert(torch.stack(distinct)) if distinct else rows[:0])
    return found


@dataclass(frozen=True)
class LinearizedModes:
    """Modes of small motions about an equilibrium, one per eigenvalue of non-negative frequency."""

    equilibrium: list[float]
    frequency_hz: list[float]
    decay_per_s: list[float]


def linearize_modes(
    lagrangian: Lagrangian, u: Float[Tensor, " n_u"] | None = None, start: Latent | None = None
) -> LinearizedModes:
    """Linearise the motion at an equilibrium, with arguments as `find_equilibrium`, and compute its modes.

    Solves ``(M s^2 + C s + K) x = 0`` with ``K`` the Hessian of the loaded potential. An over-damped pair
    gives two modes of zero frequency.

    Raises:
        NoEquilibriumError: none was found.
    """
    u = torch.zeros(lagrangian.n_inputs, dtype=torch.float64) if u is None else u
    q = find_equilibrium(lagrangian, u, start)
    stiffness = compute_static_stiffness(lagrangian, q[None], u[None])[0]
    with torch.no_grad():
        mass, damping = lagrangian.mass(q[None])[0], lagrangian.damping(q[None])[0]
    d = q.shape[0]
    top = torch.cat([torch.zeros(d, d, dtype=q.dtype), torch.eye(d, dtype=q.dtype)], 1)
    bottom = torch.linalg.solve(mass, torch.cat([-stiffness, -damping], 1))
    roots = torch.linalg.eigvals(torch.cat([top, bottom])).detach().numpy() / float(lagrangian.time_unit_s)
    roots = sorted((r for r in roots if r.imag >= 0.0), key=lambda r: (r.imag, -r.real))
    return LinearizedModes(
        equilibrium=[float(x) for x in q],
        frequency_hz=[float(r.imag / (2.0 * np.pi)) for r in roots],
        decay_per_s=[float(-r.real) for r in roots],
    )
