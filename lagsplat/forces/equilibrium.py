"""Equilibria of a law under constant inputs and a load: the minima of ``V - u.nu`` less its work."""

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from lagsplat.array_types import Inputs, Latent, Latents, Spd
from lagsplat.forces.loaded_lagrangian import LoadedLagrangian
from lagsplat.forces.loads import Load, make_no_load
from lagsplat.stage2.lagrangian import UNTOUCHED, Lagrangian, LawEdits, PreparedCoefficients

ITERATIONS = 200
TOLERANCE = 1e-10  # largest remaining force, relative to the load plus the stiffness at the start
LEAST_CURVATURE = 1e-6  # smallest curvature in a Newton step, relative to the largest
DECREASE = 1e-4  # Armijo's constant: share of the predicted decrease that a step must reach
UNRESOLVED = 1e-12  # predicted decrease, relative to 1 plus the energy, that rounding hides: a step is taken
SHORTEST = 2.0**-40  # smallest factor on a Newton step


@torch.no_grad()
def settle(
    law: Lagrangian,
    u: Inputs,
    load: Load | None = None,
    *,
    edits: LawEdits = UNTOUCHED,
    start: Latent | Latents | None = None,
) -> Latents:
    """Find the equilibria (B, d) under inputs ``u`` and a ``load``, one per row.

    Newton's method on the energy. Where its Hessian is not positive definite, eigenvalues are replaced by
    their absolute value, so that every step descends; a step is halved until the energy falls by Armijo's
    rule. The quadratic floor of ``V`` outgrows the work of a load, at most linear far away, so lower level
    sets of the energy are compact and every limit point is stationary for any network and load. ``start`` is
    the first state of the iteration, of all rows or of each, by default the rest state of the law.

    Raises:
        ValueError: energies overflow under the load, or the iterations do not suffice.

    Source: paper, Appendix "Bounded forced response"; Nocedal and Wright, Numerical Optimization, ch. 3.
    """
    load = make_no_load(law.d) if load is None else load
    loaded = LoadedLagrangian(law, load, edits=edits)
    first = law.rest.detach() if start is None else start
    q = first.expand(len(u), -1).clone()
    ready = loaded.prepare()
    force, hessian = _slopes(loaded, q, u, ready)
    pushed = load.generalise(q)
    scale = pushed.norm(dim=1) + hessian.abs().amax((1, 2))
    for _ in range(ITERATIONS if bool(torch.isfinite(scale).all()) else 0):
        moving = ~(force.norm(dim=1) <= TOLERANCE * scale)  # true for NaN, too
        if not bool(moving.any()):
            # One more Newton step where it lowers the force: responses are small differences of equilibria.
            closer = q + torch.linalg.solve_ex(hessian, force[:, :, None])[0][:, :, 0]
            remaining = loaded.conservative_force(closer, u, ready).norm(dim=1)
            return torch.where((remaining < force.norm(dim=1))[:, None], closer, q)
        q = torch.where(moving[:, None], _descend(loaded, q, u, force, hessian), q)
        force, hessian = _slopes(loaded, q, u, ready)
    left = force.norm(dim=1) / scale
    worst = int(left.nan_to_num(torch.inf).argmax())
    raise ValueError(
        f"no equilibrium was reached in {ITERATIONS} steps under the load {pushed[worst].tolist()}: "
        f"{float(left[worst]):.1e} of the force is left at q = {q[worst].tolist()}; lower the force, or "
        "look at the law's potential"
    )


def compute_loaded_energy(law: Lagrangian, q: Latents, u: Inputs) -> Float[Tensor, " B"]:
    """``V - u.nu``, less the work of the load if there is one."""
    return law.potential(q) - (law.volume(q, u) * u).sum(1)


def compute_static_stiffness(law: Lagrangian, q: Latents, u: Inputs) -> Float[Tensor, "B d d"]:
    """The symmetric Hessian of the energy at ``q``."""
    return _slopes(law, q, u, law.prepare())[1]


def _slopes(law: Lagrangian, q: Latents, u: Inputs, ready: PreparedCoefficients) -> tuple[Latents, Spd]:
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
