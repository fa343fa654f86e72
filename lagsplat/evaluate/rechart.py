"""The same law and kinematics written in other coordinates, to see that the answer does not change."""

import numpy as np
import torch
from jaxtyping import Float, Float64
from scipy.optimize import minimize, root
from torch import Tensor

from lagsplat.forces.equilibrium import energy
from lagsplat.forces.grip import Grip
from lagsplat.forces.held import Held

BEND = 0.1


def settled_elsewhere(
    held: Held, grip: Grip, force: Float64[np.ndarray, "2"], *, seed: int = 0
) -> Float[Tensor, " d"]:
    """The equilibrium under a force, found in the coordinates ``x`` of ``q = rest + reach (x + x^3/10) A``.

    ``A`` is a random matrix of condition below three. Energy, elastic force and the matter's Jacobian are
    those of the new chart, ``J Psi`` with ``Psi = dq/dx``; the solver is another one (BFGS, then Powell's
    hybrid on the slope). Returned in the chart of the run.

    Source: paper, Appendix "Invariance to the latent chart".
    """
    rng, d = np.random.default_rng(seed), held.law.d
    turns = [np.linalg.qr(rng.standard_normal((d, d)))[0] for _ in range(2)]
    mixing = held.reach * turns[0] @ np.diag(rng.uniform(0.6, 1.7, d)) @ turns[1]
    ready, rest = held.law.prepare(), held.rest.numpy()

    def back(x: np.ndarray) -> np.ndarray:
        return rest + (x + BEND * x**3) @ mixing

    def slope(x: np.ndarray) -> np.ndarray:
        stretch = (1.0 + 3.0 * BEND * x**2)[:, None] * mixing  # row i: dq / dx_i
        with torch.no_grad():
            elastic = held.law.conservative_force(torch.from_numpy(back(x))[None], held.u[None], ready)
        return -(stretch @ elastic[0].numpy() + (grip.jacobian.numpy() @ stretch.T).T @ force)

    def value(x: np.ndarray) -> float:
        q = torch.from_numpy(back(x))
        with torch.no_grad():
            return float(energy(held.law, q[None], held.u[None])[0] - torch.from_numpy(force) @ grip.place(q))

    near = minimize(value, np.zeros(d), jac=slope, method="BFGS").x
    return torch.from_numpy(back(root(slope, near, tol=1e-13).x))
