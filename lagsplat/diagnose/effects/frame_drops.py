"""Frames that show again what the camera saw one to three frames before."""

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.effect import HalfNormal, Noise, Parameter

SHARES = np.geomspace(0.0005, 0.3, 30)
LATE = (0.5, 0.25, 0.25)
"""How often a late frame is one, two and three frames late."""


def explain(
    residual: Float64[np.ndarray, " n"], speed: Float64[np.ndarray, " n"]
) -> tuple[float, dict[str, float]]:
    """A share of the samples is late by whole frames, against even noise of the best level.

    The level of the noise in the mixture is that of the middle half of the residuals.
    """
    even = float(np.mean(residual**2))
    level = min(even, float(np.median(residual**2)) / 0.455)
    good = np.exp(-0.5 * residual**2 / level)
    late = sum(
        share * np.exp(-0.5 * (residual + (k + 1) * speed) ** 2 / level) for k, share in enumerate(LATE)
    )
    plain = -0.5 * residual.size * (1.0 + np.log(even))
    best, count = 0.0, 0.0
    for share in SHARES:
        mixed = (1.0 - share) * good + share * late + 1e-300
        gain = float(np.sum(np.log(mixed))) - 0.5 * residual.size * np.log(level) - plain
        if gain > best:
            best, count = gain, float(np.sum(share * late / mixed))
    return best, {"count": count}


EFFECT = Noise(
    name="frame_drops",
    group="G",
    equation="y_k = q(t_{k-1}) for some frames k",
    parameters=(Parameter("count", "ratio", HalfNormal(100.0)),),
    needs="motion that is fast against the noise",
    along="whole",
    explain=explain,
)
