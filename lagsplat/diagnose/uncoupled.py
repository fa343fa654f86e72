"""Of the laws that tell a motion alike, the one whose coordinates have an inertia each of their own.

A linear mechanism under few inputs moves alike by ``M, C, K, b`` and by ``A M, A C, A K, A b``, as long as
these stay symmetric: no recording of it tells which. Added forces enter by ``M^-1``, however, so that
friction or a spring at one coordinate would be none at any coordinate of a law that was picked by chance.
"""

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.forms import moved
from lagsplat.diagnose.model import Model

COUPLED = 0.3
"""How far inertia is believed to couple two coordinates, as a share of their own."""


def uncoupled(model: Model, freedom: Float64[np.ndarray, "R K"]) -> tuple[Model, Float64[np.ndarray, "R K"]]:
    """The model moved within what its recordings leave open, and what is open then.

    ``freedom`` are changes of all coefficients of one standard deviation each. An inertia that depends on the
    coordinates is not moved, for the motion tells it.
    """
    if model.d == 1 or len(model.mass) > 1 or not len(freedom):
        return model, freedom
    at, across = np.diag_indices(model.d), np.triu_indices(model.d, 1)
    size = np.sqrt(np.outer(model.mass[0][at], model.mass[0][at]))[across]
    rows = freedom[:, : model.mass.size].reshape(-1, model.d, model.d)
    slope = rows[(slice(None), *across)] / (COUPLED * size)
    scatter = np.linalg.inv(np.eye(len(freedom)) + slope @ slope.T)
    far = model.mass[0][across] / (COUPLED * size)
    apart = moved(model, -(scatter @ slope @ far) @ freedom)
    if np.linalg.eigvalsh(apart.mass[0]).min() <= 0.0:
        return model, freedom
    values, vectors = np.linalg.eigh(scatter)
    return apart, (vectors * np.sqrt(np.maximum(values, 0.0))).T[::-1] @ freedom
