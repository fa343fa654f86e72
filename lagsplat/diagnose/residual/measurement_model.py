"""Whether the gap lies in how positions were measured rather than in the forces that made them."""

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

DIFFERENCE_STEP = 1e-4


@dataclass(frozen=True)
class SpeedNoise:
    """``share`` of the measurement noise's variance that grows with the square of the speed, and the chance
    ``p`` of as clear a growth if noise knew nothing of speed."""

    share: float
    p: float


def measure_speed_noise(
    smoothed: Sequence[LatentForceEstimate], *, period_s: float, seed: int = 0
) -> SpeedNoise:
    """Test noise that grows with speed: what lost, repeated or badly stamped samples look like.

    The squared remainders of the smoothed positions, against those of a random order of blocks' signs.
    """
    slopes, total = [], 0.0
    for one in smoothed:
        noise = (one.innovation / np.std(one.innovation, axis=0)) ** 2
        speed = one.v**2 / np.mean(one.v**2, axis=0)
        excess = np.sum((noise - noise.mean(axis=0)) * (speed - speed.mean(axis=0)), axis=1)
        block = (
            np.cumsum(compute_sample_weights(one)) / (RESIDUAL_FEATURES.block_periods * period_s)
        ).astype(np.int64)
        slopes.append(np.bincount(block, excess))
        total += float(np.sum((speed - speed.mean(axis=0)) ** 2))
    sums = np.concatenate(slopes)
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], (MEASUREMENT_MODEL.sign_flips, len(sums)))
    p = (1.0 + np.sum(signs @ sums >= sums.sum())) / (1.0 + MEASUREMENT_MODEL.sign_flips)
    return SpeedNoise(float(np.clip(sums.sum() / max(total, 1e-300), 0.0, 1.0)), float(p))


def compute_apparent_forces(
    mechanics: Mechanics, smoothed: Sequence[LatentForceEstimate], coordinate: int
) -> Float64[np.ndarray, "n 3d"]:
    """Residual acceleration of ``coordinate`` that distorted positions would feign, were the forces right.

    Columns: for each coordinate, positions bent by their square, moved in time, and drifting. A small
    distortion e(t) of the positions feigns M(q) (e'' - da/dq e - da/dv e') over the inertia at rest.
    """
    return np.concatenate([_compute_apparent_columns(mechanics, one)[:, coordinate] for one in smoothed])


def _compute_apparent_columns(
    mechanics: Mechanics, one: LatentForceEstimate
) -> Float64[np.ndarray, "n d 3d"]:
    d, time_s = mechanics.d, one.motion.time_s
    jerk = np.zeros_like(one.a)
    for start, stop in one.motion.segments:
        if stop - start > 1:
            jerk[start:stop] = np.gradient(one.a[start:stop], time_s[start:stop], axis=0)
    s = one.q - mechanics.rest
    elapsed = (time_s - time_s[0])[:, None]
    zero = np.zeros_like(s)
    distortions = [
        (s**2, 2 * s * one.v, 2 * one.v**2 + 2 * s * one.a),
        (one.v, one.a, jerk),
        (elapsed + zero, 1.0 + zero, zero),
    ]
    columns = []
    for e, rate, bend in distortions:
        for j in range(d):
            own = np.arange(d) == j
            eps = DIFFERENCE_STEP * np.std(one.q[:, j]) / max(float(np.abs(e[:, j]).max()), 1e-300)
            up, down = (
                mechanics.acceleration(
                    one.q + sign * eps * e * own, one.v + sign * eps * rate * own, one.motion.u
                )
                for sign in (1.0, -1.0)
            )
            lacking = bend * own - (up - down) / (2.0 * eps)
            columns.append(
                np.einsum("nab,nb->na", mechanics.mass_at(one.q), lacking) / compute_rest_inertia(mechanics)
            )
    return np.stack(columns, axis=2)


def compute_distortion_share(
    found: ResidualFeatures, mechanics: Mechanics, smoothed: Sequence[LatentForceEstimate], coordinate: int
) -> float:
    """Share of a coordinate's residual that distorted positions predict on left-out blocks."""
    columns = compute_apparent_forces(mechanics, smoothed, coordinate)
    return compute_explained_share(found, coordinate, columns[found.picked])
