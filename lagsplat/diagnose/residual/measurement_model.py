"""Whether the gap lies in how positions are measured rather than in the forces that act."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.core.config import STATE_MAPS
from lagsplat.diagnose.mechanics.model import MechanicalModel, compute_rest_inertia
from lagsplat.diagnose.residual.change_points import number_blocks
from lagsplat.diagnose.residual.features import differentiate_clips
from lagsplat.diagnose.residual.latent_force import LatentForceEstimate, join_signals

DIFFERENCE_STEP = 1e-4  # step of central differences, over the standard deviation of a coordinate


@dataclass(frozen=True)
class SpeedNoise:
    """Measurement noise that grows with speed."""

    share: float  # of the noise's variance that grows with the square of the speed
    p: float  # chance of as large a share if noise does not depend on speed


def measure_speed_noise(
    estimates: Sequence[LatentForceEstimate], *, period_s: float, seed: int = 0
) -> SpeedNoise:
    """Measure noise that grows with speed, as lost, repeated or wrongly timed samples cause.

    The slope of squared innovations over squared speed is compared with its slopes under random signs of
    blocks. ``period_s`` is the natural period [s], ``seed`` that of the signs.
    """
    excess, total = [], 0.0
    for estimate in estimates:
        noise, speed = estimate.innovation**2 / np.var(estimate.innovation, axis=0), estimate.v**2
        faster = speed / np.mean(speed, axis=0) - 1.0
        excess.append(np.sum((noise - noise.mean(axis=0)) * faster, axis=1))
        total += float(np.sum(faster**2))
    sums = np.bincount(number_blocks(estimates, period_s), np.concatenate(excess))
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], (STATE_MAPS.sign_flips, len(sums)))
    p = (1.0 + np.sum(signs @ sums >= sums.sum())) / (1.0 + STATE_MAPS.sign_flips)
    return SpeedNoise(float(np.clip(sums.sum() / max(total, 1e-300), 0.0, 1.0)), float(p))


def compute_apparent_forces(
    mechanics: MechanicalModel, estimates: Sequence[LatentForceEstimate], coordinate: int
) -> Float64[np.ndarray, "n 3d"]:
    """Residual acceleration of ``coordinate`` that distorted measurements cause where the simulator is right.

    Columns, for each coordinate: positions distorted by their square, shifted in time, and drifting. A small
    distortion e(t) of the positions appears as M(q) (e'' - da/dq e - da/dv e') over the inertia at rest.
    """
    q, v, a, u = join_signals(estimates, "q", "v", "a", "u")
    jerk = np.concatenate([differentiate_clips(each.a, each.motion) for each in estimates])
    times_s = [each.motion.time_s - each.motion.time_s[0] for each in estimates]
    elapsed, displacement, zero = np.concatenate(times_s)[:, None], q - mechanics.rest, np.zeros_like(q)
    distortions = [
        (displacement**2, 2 * displacement * v, 2 * v**2 + 2 * displacement * a),
        (v, a, jerk),
        (elapsed + zero, 1.0 + zero, zero),
    ]
    inertia = mechanics.mass_at(q)[:, coordinate] / compute_rest_inertia(mechanics)[coordinate]
    columns = []
    for e, rate, bend in distortions:
        for j in range(mechanics.d):
            unit = np.arange(mechanics.d) == j
            eps = DIFFERENCE_STEP * np.std(q[:, j]) / max(float(np.abs(e[:, j]).max()), 1e-300)
            dq, dv = eps * e * unit, eps * rate * unit
            up, down = (mechanics.acceleration(q + s * dq, v + s * dv, u) for s in (1.0, -1.0))
            lacking = bend * unit - (up - down) / (2.0 * eps)
            columns.append(np.einsum("nb,nb->n", inertia, lacking))
    return np.stack(columns, axis=1)
