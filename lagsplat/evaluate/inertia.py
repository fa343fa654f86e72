"""How much the learned inertia depends on the state, along a trajectory."""

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.stage2.lagrangian import Lagrangian

STATES = 2000  # at most so many, evenly spaced


def inertia_along(lagrangian: Lagrangian, states: Float64[np.ndarray, "T d"]) -> dict[str, float]:
    """The mass matrix at whitened states, as plain numbers without unit.

    ``state_dependence`` is the rms distance of the matrices from their mean over the rms of the matrices
    (Frobenius norms): 0 for a constant mass. ``span`` is the largest over the smallest eigenvalue relative to
    the mean matrix, anywhere on the trajectory: 1 for a constant mass, and the same in any chart.
    ``condition_median`` and ``condition_max`` are condition numbers in the whitened chart.

    Source: paper, "Decoder-induced inertia".
    """
    chosen = states[np.unique(np.linspace(0, len(states) - 1, min(STATES, len(states))).round().astype(int))]
    with torch.no_grad():
        matrices = lagrangian.mass(torch.from_numpy(chosen)).double().numpy()
    mean = matrices.mean(axis=0)
    apart, size = (np.sqrt(np.mean(np.sum(part**2, axis=(1, 2)))) for part in (matrices - mean, matrices))
    values = np.linalg.eigvalsh(matrices)
    half = np.linalg.inv(np.linalg.cholesky(mean))
    relative = np.linalg.eigvalsh(half @ matrices @ half.T)
    condition = values[:, -1] / values[:, 0]
    return {
        "state_dependence": float(apart / size),
        "span": float(relative.max() / relative.min()),
        "condition_median": float(np.median(condition)),
        "condition_max": float(condition.max()),
        "states": len(chosen),
    }
