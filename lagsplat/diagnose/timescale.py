"""How fast a mechanism swings about its rest, from its own equations."""

import numpy as np
from jaxtyping import Float64
from scipy.linalg import eig

from lagsplat.diagnose.mechanics import Mechanics

STEP = 1e-4


def rest_frequencies_hz(
    mechanics: Mechanics, scale: Float64[np.ndarray, " d"]
) -> Float64[np.ndarray, " modes"]:
    """Undamped natural frequencies at rest, rising; only those of modes that are pulled back, if any.

    ``scale`` (d,) is how far each coordinate usually moves: stiffness is the slope of the force across a
    ten-thousandth of it, without inputs.
    """
    d = mechanics.d
    rest = np.asarray(mechanics.rest, dtype=float)
    step = STEP * np.diag(scale)
    zero = np.zeros((d, d))
    inputs = np.zeros((d, mechanics.n_u))
    rise = mechanics.force(rest + step, zero, inputs) - mechanics.force(rest - step, zero, inputs)
    stiffness = -(rise / (2.0 * STEP * scale[:, None])).T
    squares = eig(stiffness, mechanics.mass_at(rest[None])[0], right=False)
    # A stiffness not symmetric (a learned one) may have a small imaginary part: its real part swings.
    return np.sqrt(np.sort(squares.real[squares.real > 0.0])) / (2.0 * np.pi)


def rest_period_s(mechanics: Mechanics, scale: Float64[np.ndarray, " d"]) -> float:
    """Period of the slowest mode [s].

    Raises:
        ValueError: no mode is pulled back to rest.
    """
    frequencies = rest_frequencies_hz(mechanics, scale)
    if not frequencies.size:
        raise ValueError(
            f"the sim is not pulled back to its rest {np.asarray(mechanics.rest).tolist()}, so that it has "
            "no natural period; give period_s"
        )
    return float(1.0 / frequencies[0])
