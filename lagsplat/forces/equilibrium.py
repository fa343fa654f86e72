"""Where a law settles under held inputs and held forces: the minimum of ``V - u.nu - load.q``."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from lagsplat.forces.loaded import UNTOUCHED, Edits, Loaded
from lagsplat.shapes import Inputs, Latents
from lagsplat.stage2.lagrangian import Lagrangian, Prepared

ITERATIONS = 200
TOLERANCE = 1e-10
"""Of the force left over, relative to the load and to the force that a whitened unit takes at the start."""
LEAST_CURVATURE = 1e-6
"""Relative to the largest: below it, or negative, a curvature is replaced before the step."""
DECREASE = 1e-4
UNRESOLVED = 1e-12
"""Of the energy, or of one: gains below it drown in rounding, and Newton's step is taken as it is."""
SHORTEST = 2.0**-40


class NotSettledError(ValueError):
    """An equilibrium that was not reached, for instance because the energy left the finite numbers."""


def settle(
    law: Lagrangian,
    u: Inputs,
    load: Float[Tensor, "B d"],
    *,
    edits: Edits = UNTOUCHED,
    start: Float[Tensor, " d"] | None = None,
) -> Latents:
    """The equilibria (B, d) under inputs ``u`` and generalised forces ``load``, one a row.

    Newton's method on the energy: where its Hessian is not positive definite its eigenvalues are replaced by
    their size, so that each direction descends, and a step is halved until the energy falls by Armijo's rule.
    The energy is coercive (the quadratic floor of ``V`` outgrows a load, linear in ``q``), so its lower level
    sets are compact and every limit point is stationary, whatever the networks learned and however large the
    load. Begins at ``start``, or at the law's rest state.

    Raises:
        NotSettledError: the load is so large that energies overflow, or the iterations do not suffice.
        ValueError: a load that is not finite.

    Source: paper, Appendix "Bounded forced response"; Nocedal and Wright, Numerical Optimization, ch. 3.
    """
    loaded = Loaded(law, load, edits=edits)
    first = law.rest.detach() if start is None else start
    q = first.expand(len(load), -1).clone()
    ready = loaded.prepare()
    force, hessian = _slopes(loaded, q, u, ready)
    scale = load.norm(dim=1) + hessian.abs().amax((1, 2))
    overflow = not bool(torch.isfinite(scale).all())
    for _ in range(0 if overflow else ITERATIONS):
        left = ~(force.norm(dim=1) <= TOLERANCE * scale)  # what is not a number is left, too
        if not bool(left.any()):
            return _polished(loaded, q, u, force, hessian, ready)
        q = torch.where(left[:, None], _descend(loaded, q, u, force, hessian), q)
        force, hessian = _slopes(loaded, q, u, ready)
    worst = int((force.norm(dim=1) / scale).nan_to_num(torch.inf).argmax())
    raise NotSettledError(
        f"no equilibrium was reached in {ITERATIONS} steps under the load {load[worst].tolist()}: "
        f"{float(force[worst].norm() / scale[worst]):.1e} of the force is left at q = {q[worst].tolist()}; "
        "lower the force, or look at the law's potential"
    )


def energy(law: Lagrangian, q: Latents, u: Inputs) -> Float[Tensor, " B"]:
    """``V - u.nu``, and less the work of the load if there is one."""
    return law.potential(q) - (law.volume(q, u) * u).sum(1)


def stiffness(law: Lagrangian, q: Latents, u: Inputs) -> Float[Tensor, "B d d"]:
    """The symmetric Hessian of the energy at ``q``."""
    return _slopes(law, q, u, law.prepare())[1]


def _slopes(
    law: Lagrangian, q: Latents, u: Inputs, ready: Prepared
) -> tuple[Latents, Float[Tensor, "B d d"]]:
    """Force at ``q`` and the symmetric Hessian of the energy."""
    with torch.enable_grad():
        point = q.detach().requires_grad_()
        force = law.conservative_force(point, u, ready)
        rows = [torch.autograd.grad(part.sum(), point, retain_graph=True)[0] for part in force.unbind(1)]
    hessian = -torch.stack(rows, 1).detach()
    return force.detach(), 0.5 * (hessian + hessian.mT)


@torch.no_grad()
def _descend(
    law: Lagrangian, q: Latents, u: Inputs, force: Latents, hessian: Float[Tensor, "B d d"]
) -> Latents:
    values, vectors = torch.linalg.eigh(hessian.nan_to_num())
    size = values.abs()
    size = size.clamp(min=LEAST_CURVATURE * size.amax(1, keepdim=True).clamp(min=1e-300))
    step = (vectors @ ((vectors.mT @ force[:, :, None])[:, :, 0] / size)[:, :, None])[:, :, 0]
    gain = (step * force).sum(1)
    before = energy(law, q, u)
    fine = gain <= UNRESOLVED * (1.0 + before.abs())
    length = torch.ones_like(gain)
    while True:
        after = energy(law, q + length[:, None] * step, u)
        falls: Bool[Tensor, " B"] = fine | (after <= before - DECREASE * length * gain)
        if bool(falls.all()) or float(length.min()) < SHORTEST:
            return torch.where(falls[:, None], q + length[:, None] * step, q)
        length = torch.where(falls, length, 0.5 * length)


@torch.no_grad()
def _polished(
    law: Lagrangian,
    q: Latents,
    u: Inputs,
    force: Latents,
    hessian: Float[Tensor, "B d d"],
    ready: Prepared,
) -> Latents:
    """After one more Newton step where that leaves less of the force: differences of answers are small."""
    closer = q + torch.linalg.solve_ex(hessian, force[:, :, None])[0][:, :, 0]
    left = law.conservative_force(closer, u, ready).norm(dim=1)
    return torch.where((left < force.norm(dim=1))[:, None], closer, q)
