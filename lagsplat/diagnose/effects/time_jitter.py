"""Instants of the frames that are only known roughly: noise that grows with the speed."""

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.effect import HalfNormal, Noise, Parameter

SIZES = np.geomspace(0.003, 3.0, 80)
LEVELS = np.geomspace(0.3, 1.0, 12)


def explain(
    residual: Float64[np.ndarray, " n"], speed: Float64[np.ndarray, " n"]
) -> tuple[float, dict[str, float], float]:
    """Noise of variance ``level + (std speed)^2`` against even noise of the best level."""
    even = float(np.mean(residual**2))
    best, found, misfit = 0.0, 0.0, float(np.sum(residual**2))
    for level in even * LEVELS:
        for size in SIZES:
            variance = level + (size * speed) ** 2
            gain = -0.5 * float(np.sum(residual**2 / variance + np.log(variance / even) - 1.0))
            if gain > best:
                best, found = gain, float(size)
                misfit = float(np.sum(residual**2 * level / variance))
    return best, {"std": found}, misfit


EFFECT = Noise(
    name="time_jitter",
    group="G",
    equation="y = q(t + e), e of standard deviation std",
    parameters=(Parameter("std", "frame", HalfNormal(0.5)),),
    needs="fast and slow stretches",
    along="whole",
    explain=explain,
)
