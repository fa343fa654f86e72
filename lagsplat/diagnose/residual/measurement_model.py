"""Whether the gap lies in how positions are measured rather than in the forces that act."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.core.config import MEASUREMENT_MODEL, RESIDUAL_FEATURES
from lagsplat.diagnose.mechanics.model import Mechanics, compute_rest_inertia
from lagsplat.diagnose.residual.change_points import compute_sample_weights
from lagsplat.diagnose.residual.components import compute_explained_share
from lagsplat.diagnose.residual.features import ResidualFeatures
from lagsplat.diagnose.residual.latent_force import LatentForceEstimate

DIFFERENCE_STEP = 1e-4  # step of central differences, over the standard deviation of a coordinate


@dataclass(frozen=True)
class SpeedNoise:
    """Measurement noise that grows with speed.

    ``share`` of the noise's variance that grows with the square of the speed; ``p``, the chance of as large a
    share if noise does not depend on speed.
    """

    share: float
    p: float


def measure_speed_noise(
    estimates: Sequence[LatentForceEstimate], *, period_s: float, seed: int = 0
) -> SpeedNoise:
    """Measure noise that grows with speed, as lost, repeated or wrongly timed samples cause.

    The slope of squared innovations over squared speed is compared with its slopes under random signs of
    blocks. ``period_s`` is the natural period [s], ``seed`` that of the signs.
    """
    slopes, total = [], 0.0
    for estimate in estimates:
        noise = (estimate.innovation / np.std(estimate.innovation, axis=0)) ** 2
        speed = estimate.v**2 / np.mean(estimate.v**2, axis=0)
        excess = np.sum((noise - noise.mean(axis=0)) * (speed - speed.mean(axis=0)), axis=1)
        block = (
            np.cumsum(compute_sample_weights(estimate)) / (RESIDUAL_FEATURES.block_periods * period_s)
        ).astype(np.int64)
        slopes.append(np.bincount(block, excess))
        total += float(np.sum((speed - speed.mean(axis=0)) ** 2))
    sums = np.concatenate(slopes)
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], (MEASUREMENT_MODEL.sign_flips, len(sums)))
    p = (1.0 + np.sum(signs @ sums >= sums.sum())) / (1.0 + MEASUREMENT_MODEL.sign_flips)
    return SpeedNoise(float(np.clip(sums.sum() / max(total, 1e-300), 0.0, 1.0)), float(p))


def compute_apparent_forces(
    mechanics: Mechanics, estimates: Sequence[LatentForceEstimate], coordinate: int
) -> Float64[np.ndarray, "n 3d"]:
    """Residual acceleration of ``coordinate`` that distorted measurements cause where the simulator is right.

    Columns, for each coordinate: positions distorted by their square, shifted in time, and drifting. A small
    distortion e(t) of the positions appears as M(q) (e'' - da/dq e - da/dv e') over the inertia at rest.
    """
    return np.concatenate(
        [_compute_apparent_columns(mechanics, estimate)[:, coordinate] for estimate in estimates]
    )


def _compute_apparent_columns(
    mechanics: Mechanics, estimate: LatentForceEstimate
) -> Float64[np.ndarray, "n d 3d"]:
    d, time_s = mechanics.d, estimate.motion.time_s
    jerk = np.zeros_like(estimate.a)
    for start, stop in estimate.motion.segments:
        if stop - start > 1:
            jerk[start:stop] = np.gradient(estimate.a[start:stop], time_s[start:stop], axis=0)
    displacement = estimate.q - mechanics.rest
    elapsed = (time_s - time_s[0])[:, None]
    zero = np.zeros_like(displacement)
    distortions = [
        (displacement**2, 2 * displacement * estimate.v, 2 * estimate.v**2 + 2 * displacement * estimate.a),
        (estimate.v, estimate.a, jerk),
        (elapsed + zero, 1.0 + zero, zero),
    ]
    columns = []
    for e, rate, bend in distortions:
        for j in range(d):
            unit = np.arange(d) == j
            eps = DIFFERENCE_STEP * np.std(estimate.q[:, j]) / max(float(np.abs(e[:, j]).max()), 1e-300)
            up, down = (
                mechanics.acceleration(
                    estimate.q + sign * eps * e * unit,
                    estimate.v + sign * eps * rate * unit,
                    estimate.motion.u,
                )
                for sign in (1.0, -1.0)
            )
            lacking = bend * unit - (up - down) / (2.0 * eps)
            columns.append(
                np.einsum("nab,nb->na", mechanics.mass_at(estimate.q), lacking)
                / compute_rest_inertia(mechanics)
            )
    return np.stack(columns, axis=2)


def compute_distortion_share(
    features: ResidualFeatures,
    mechanics: Mechanics,
    estimates: Sequence[LatentForceEstimate],
    coordinate: int,
) -> float:
    """Share of a coordinate's residual that distorted measurements predict on left-out blocks.

    Args:
        features: samples of the residual.
        mechanics: the simulator's equations of motion.
        estimates: the motions and their residuals.
        coordinate: number of the coordinate.
    """
    columns = compute_apparent_forces(mechanics, estimates, coordinate)
    return compute_explained_share(features, coordinate, columns[features.picked])
