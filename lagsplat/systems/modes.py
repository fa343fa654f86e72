"""Linear free modes of a mechanism at rest."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64


@dataclass(frozen=True)
class Modes:
    """Linear free modes at rest, slowest first.

    ``natural_hz`` is ``|lambda| / 2 pi``, ``damped_hz`` the frequency a decaying record shows,
    ``decay_per_s`` its envelope's rate and ``damping_ratio = decay / |lambda|``.
    """

    natural_hz: Float64[np.ndarray, " n_modes"]
    damped_hz: Float64[np.ndarray, " n_modes"]
    decay_per_s: Float64[np.ndarray, " n_modes"]
    damping_ratio: Float64[np.ndarray, " n_modes"]


def linear_modes(
    mass: Float64[np.ndarray, "d d"],
    damping: Float64[np.ndarray, "d d"],
    stiffness: Float64[np.ndarray, "d d"],
) -> Modes:
    """Oscillating solutions of ``M x'' + C x' + K x = 0``; overdamped directions are left out."""
    d = len(mass)
    inverse = np.linalg.inv(mass)
    lower = np.hstack([-inverse @ stiffness, -inverse @ damping])
    upper = np.hstack([np.zeros((d, d)), np.eye(d)])
    roots = np.linalg.eigvals(np.vstack([upper, lower]))
    roots = roots[roots.imag > 0]
    roots = roots[np.argsort(np.abs(roots))]
    size = np.abs(roots)
    return Modes(size / (2 * np.pi), roots.imag / (2 * np.pi), -roots.real, -roots.real / size)
