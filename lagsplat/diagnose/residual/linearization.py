"""One sample step of a mechanism under an additional force, linearised along a path.

The step from sample ``k`` to ``k + 1`` is

    (q, v)_{k+1} = Phi_k (q, v)_k + sum_j Gamma_{k, j} r(t_k + j h / 2) + c_k,      j = 0, 1, 2,

with ``r`` the additional force as an acceleration (divided by the inertia at rest) at the start, middle and
end of the step. Gamma follows from Simpson's rule, Phi from central differences of a Runge-Kutta step, c from
that step itself along the path: at the path itself, the linear map is exact.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.core.config import LATENT_FORCE
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.stage2.runge_kutta import take_runge_kutta_step

DIFFERENCE_STEP = 1e-5
"""Step of central differences, over the scale of a coordinate: about the cube root of the precision."""
MAX_SUBSTEPS = 300  # Runge-Kutta steps that a sample is worth


@dataclass(frozen=True)
class StatePath:
    """States and additional force about which steps are linearised."""

    h: Float64[np.ndarray, " S"]  # step lengths [s]
    q: Float64[np.ndarray, "S d"]  # positions at the start
    v: Float64[np.ndarray, "S d"]  # velocities at the start
    middle: Float64[np.ndarray, "S d"]  # positions in the middle of the step
    end: Float64[np.ndarray, "S d"]  # positions at its end
    u: Float64[np.ndarray, "S 3 n_u"]  # inputs at start, middle and end
    r: Float64[np.ndarray, "S 3 d"]  # additional force at start, middle and end


@dataclass(frozen=True)
class LinearSteps:
    """Linear steps, in the symbols of the module."""

    phi: Float64[np.ndarray, "S 2d 2d"]
    gamma: Float64[np.ndarray, "S 3 2d d"]
    offset: Float64[np.ndarray, "S 2d"]


def linearize_steps(
    mechanics: MechanicalModel, path: StatePath, *, scale: Float64[np.ndarray, " d"], period_s: float
) -> LinearSteps:
    """Linearise the steps of a mechanism along ``path``.

    ``scale``, the typical excursion of each coordinate, sets the size of the differences, and ``period_s``,
    the shortest natural period [s], the number of Runge-Kutta steps in a sample step.

    Raises:
        LinAlgError: the fastest mode needs more than `MAX_SUBSTEPS` of these.
    """
    d, n = mechanics.d, len(path.h)
    inertia = np.diag(mechanics.rest_inertia)
    along = (path.q, path.middle, path.end)
    response = np.stack([np.linalg.solve(mechanics.mass_at(q), inertia) for q in along], axis=1)
    state = np.concatenate([path.q, path.v], axis=1)
    eps = DIFFERENCE_STEP * np.concatenate([scale, scale * 2.0 * np.pi / period_s])
    moves = np.concatenate([np.zeros((1, 2 * d)), np.diag(eps), -np.diag(eps)])
    given = (path.h[:, None], path.u, np.einsum("sjab,sjb->sja", response, path.r))
    h, u, added = (np.concatenate([values] * len(moves)) for values in given)
    moved = (state + moves[:, None, :]).reshape(-1, 2 * d)
    reached = integrate_steps(mechanics, moved, h, u, added, _count_substeps(path.h, period_s))
    middle, up, down = np.split(reached.reshape(-1, n, 2 * d), [1, 2 * d + 1])
    phi = np.moveaxis((up - down) / (2.0 * eps[:, None, None]), 0, 2)
    gamma = _compute_simpson_response(response, path.h)
    offset = middle[0] - np.einsum("sab,sb->sa", phi, state) - np.einsum("sjab,sjb->sa", gamma, path.r)
    return LinearSteps(phi, gamma, offset)


def _count_substeps(h: np.ndarray, period_s: float) -> int:
    """Number of Runge-Kutta steps in each sample step, enough for the longest."""
    parts = float(np.ceil(h.max(initial=0.0) * 2.0 * np.pi / period_s / LATENT_FORCE.max_step_rad))
    if not parts <= MAX_SUBSTEPS:
        raise np.linalg.LinAlgError(
            f"the sim's fastest mode, {1.0 / period_s:.3g} Hz, needs {parts:.3g} integration steps a sample; "
            "check its units and signs"
        )
    return max(1, int(parts))


def compute_kinematic_steps(h: Float64[np.ndarray, " S"], d: int) -> LinearSteps:
    """Steps of lengths ``h`` without any mechanics: all acceleration is the additional force."""
    phi = np.broadcast_to(np.eye(2 * d), (len(h), 2 * d, 2 * d)).copy()
    phi[:, :d, d:] = h[:, None, None] * np.eye(d)
    response = np.broadcast_to(np.eye(d), (len(h), 3, d, d))
    return LinearSteps(phi, _compute_simpson_response(response, h), np.zeros((len(h), 2 * d)))


def _compute_simpson_response(response: np.ndarray, h: np.ndarray) -> np.ndarray:
    """Effect of the additional force at three instants on position and velocity, (S, 3, 2d, d)."""
    to_velocity = np.array([1.0, 4.0, 1.0]) / 6.0
    to_position = np.array([1.0, 2.0, 0.0]) / 6.0
    h = h[:, None, None, None]
    rows = h * response
    return np.concatenate([h * to_position[:, None, None] * rows, to_velocity[:, None, None] * rows], axis=2)


def integrate_steps(
    mechanics: MechanicalModel,
    state: Float64[np.ndarray, "N 2d"],
    h: Float64[np.ndarray, "N 1"],
    u: Float64[np.ndarray, "N 3 n_u"],
    added: Float64[np.ndarray, "N 3 d"],
    count: int,
) -> Float64[np.ndarray, "N 2d"]:
    """Positions and velocities after steps of lengths ``h`` [s], by ``count`` Runge-Kutta steps in each.

    Inputs ``u`` and additional accelerations ``added``, given at start, middle and end, follow parabolas.
    """
    d = mechanics.d

    def slope(x: np.ndarray, phase: float) -> np.ndarray:
        weights = [(1 - phase) * (1 - 2 * phase), 4 * phase * (1 - phase), phase * (2 * phase - 1)]
        inputs, more = (np.einsum("njc,j->nc", values, weights) for values in (u, added))
        acceleration = mechanics.acceleration(x[:, :d], x[:, d:], inputs) + more
        return np.concatenate([x[:, d:], acceleration], axis=1)

    for step in range(count):
        start, middle, end = ((step + share) / count for share in (0.0, 0.5, 1.0))
        state = take_runge_kutta_step(slope, state, h / count, (start, middle, end))
    return state
