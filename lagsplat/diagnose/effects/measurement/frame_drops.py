"""Lost or repeated samples: some samples, as frames of a camera, show what was measured a few before."""

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.base import SampleEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, HalfNormal

SHARES = np.geomspace(0.0005, 0.3, 30)  # grid of the share of late frames [1], to maximise the likelihood
LATE = (0.4, 0.25, 0.15, 0.1, 0.06, 0.04)  # how often a late frame is one, two, three ... frames late.


def explain(
    residual: Float64[np.ndarray, "n d"], speed: Float64[np.ndarray, "n d"]
) -> tuple[float, dict[str, tuple[float, float, float]], float]:
    """Compare a mixture, in which a share of the frames is late by whole frames, with even noise.

    A frame is late in all coordinates. The mixture's noise is that of the middle half of the residuals.
    """
    even = float(np.mean(residual**2))
    level = min(even, float(np.median(residual**2)) / 0.455)
    off = np.stack([np.sum((residual + k * speed) ** 2, axis=1) for k in range(len(LATE) + 1)])
    good = np.exp(-0.5 * off[0] / level)
    late = np.array(LATE) @ np.exp(-0.5 * off[1:] / level)
    plain = -0.5 * residual.size * (1.0 + np.log(even))
    best, count = 0.0, 0.0
    for share in SHARES:
        mixed = (1.0 - share) * good + share * late + 1e-300
        gain = float(np.sum(np.log(mixed))) - 0.5 * residual.size * np.log(level) - plain
        if gain > best:
            best, count = gain, float(np.sum(share * late / mixed))
    about = 1.645 * count**0.5
    return best, {"count": (count, max(count - about, 0.0), count + about)}, float(off.min(axis=0).sum())


EFFECT = SampleEffect(
    name="frame_drops",
    number=3,
    equation="y_k = q(t_{k-1}) for some samples k",
    parameters=(EffectParameter("count", "ratio", HalfNormal(100.0)),),
    needs="motion that is fast against the noise",
    explain=explain,
    repeats=True,
    mujoco="it concerns the samples of the recording, not the mechanism.",
    title="lost or repeated samples",
    what="Some samples are missing or given twice, and the clock does not say so.",
    symptom="The motion halts or leaps for single samples.",
    remedy="Record again without losses, or cut there; leave the simulation alone.",
    short_title="lost or repeated samples",
)
