"""What the learned Lagrangian says in physical units: equilibria, natural frequencies and decay rates."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from scipy.optimize import minimize
from torch import Tensor
from torch.autograd.functional import jacobian

from lagsplat.stage2.lagrangian import Lagrangian


@dataclass(frozen=True)
class Modes:
    """Small motions about an equilibrium: one entry per eigenvalue with non-negative frequency."""

    equilibrium: list[float]
    frequency_hz: list[float]
    decay_per_s: list[float]


def equilibrium(lagrangian: Lagrangian, u: Float[Tensor, " n_u"]) -> Float[Tensor, " d"]:
    """Where the system settles under a constant input: the minimum of ``V - u.nu``."""

    def energy_and_slope(flat: np.ndarray) -> tuple[float, np.ndarray]:
        q = torch.from_numpy(flat)[None]
        with torch.no_grad():
            value = lagrangian.potential(q)[0] - (lagrangian.volume(q, u[None])[0] * u).sum()
            slope = -lagrangian.conservative_force(q, u[None], lagrangian.prepare())[0]
        return float(value), slope.numpy()

    first = lagrangian.rest.detach().numpy()
    found = minimize(energy_and_slope, first, jac=True, method="BFGS", options={"gtol": 1e-9})
    return torch.from_numpy(found.x)


def modes(lagrangian: Lagrangian, u: Float[Tensor, " n_u"]) -> Modes:
    """Eigenvalues of the motion linearised at the equilibrium under ``u``.

    Solves ``(M s^2 + C s + K) x = 0`` with ``K`` the Hessian of the loaded potential. An over-damped pair
    appears as two entries of zero frequency.
    """
    q = equilibrium(lagrangian, u)
    ready = lagrangian.prepare()
    force = jacobian(lambda x: lagrangian.conservative_force(x[None], u[None], ready)[0], q)
    with torch.no_grad():
        mass, damping = lagrangian.mass(q[None])[0], lagrangian.damping(q[None])[0]
    d = q.shape[0]
    top = torch.cat([torch.zeros(d, d, dtype=q.dtype), torch.eye(d, dtype=q.dtype)], 1)
    bottom = torch.linalg.solve(mass, torch.cat([force, -damping], 1))
    roots = torch.linalg.eigvals(torch.cat([top, bottom])).detach().numpy() / float(lagrangian.time_unit_s)
    roots = sorted((r for r in roots if r.imag >= 0.0), key=lambda r: (r.imag, -r.real))
    return Modes(
        equilibrium=[float(x) for x in q],
        frequency_hz=[float(r.imag / (2.0 * np.pi)) for r in roots],
        decay_per_s=[float(-r.real) for r in roots],
    )
