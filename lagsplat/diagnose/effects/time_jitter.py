"""Instants of the frames that are only known roughly: noise that grows with the speed."""

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.effect import HalfNormal, Noise, Parameter

SIZES = np.geomspace(0.003, 3.0, 80)
LEVELS = np.geomspace(0.05, 1.0, 16)
INSIDE = 1.353
"""Nats below the best at which the 90 % interval of one parameter ends."""


def explain(
    residual: Float64[np.ndarray, " n"], speed: Float64[np.ndarray, " n"]
) -> tuple[float, dict[str, tuple[float, float, float]], float]:
    """Noise of variance ``level + (std speed)^2`` against even noise of the best level."""
    even = float(np.mean(residual**2))
    levels, sizes = even * LEVELS, np.concatenate([[0.0], SIZES])
    variance = levels[:, None, None] + (sizes[None, :, None] * speed) ** 2
    gains = -0.5 * np.sum(residual**2 / variance + np.log(variance / even) - 1.0, axis=2)
    level, size = np.unravel_index(int(np.argmax(gains)), gains.shape)
    likely = sizes[gains.max(axis=0) > gains.max() - INSIDE]
    misfit = float(np.sum(residual**2 * levels[level] / variance[level, size]))
    found = (float(sizes[size]), float(likely.min()), float(likely.max()))
    return max(float(gains.max()), 0.0), {"std": found}, misfit


EFFECT = Noise(
    name="time_jitter",
    group="G",
    level="perception",
    equation="y = q(t + e), e of standard deviation std",
    parameters=(Parameter("std", "frame", HalfNormal(0.5)),),
    needs="fast and slow stretches",
    along="whole",
    explain=explain,
)
