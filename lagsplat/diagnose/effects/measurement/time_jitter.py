"""Time stamps that scatter: noise that grows with the speed."""

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.base import SampleEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, HalfNormal

SIZES = np.geomspace(0.003, 3.0, 80)  # grid of the jitter [frames], for the maximum of the likelihood
LEVELS = np.geomspace(0.05, 1.0, 16)  # grid of the remaining noise [assumed standard deviations]
SPEEDS = 200  # groups of samples of nearly the same speed [count]
INSIDE = 1.353  # nats below the best at which the 90 % interval of one parameter ends


def explain(
    residual: Float64[np.ndarray, "n d"], speed: Float64[np.ndarray, "n d"]
) -> tuple[float, dict[str, tuple[float, float, float]], float]:
    """Compare noise of covariance ``level I + std^2 speed speed^T`` with even noise of the best level.

    A wrong instant moves all coordinates at once along their speed. The error of a law grows with speed,
    too, but with that of each coordinate alone: of several coordinates, jitter must be likelier than that.
    """
    even = float(np.mean(residual**2))
    levels, sizes = even * LEVELS, np.concatenate([[0.0], SIZES])
    fast = np.sum(speed**2, axis=1)
    along = np.sum(residual * speed, axis=1) ** 2 / np.maximum(fast, np.finfo(float).tiny)
    across = np.sum(residual**2, axis=1) - along
    rest = np.sum(across) / levels + across.size * (residual.shape[1] - 1) * (np.log(levels / even) - 1.0)
    gains = _gains(along, fast, even) - 0.5 * rest[:, None]
    level, size = np.unravel_index(int(np.argmax(gains)), gains.shape)
    likely = sizes[gains.max(axis=0) > gains.max() - INSIDE]
    shaken = levels[level] + sizes[size] ** 2 * fast
    misfit = float(np.sum(across + along * levels[level] / shaken))
    gain = float(gains.max())
    if residual.shape[1] > 1:
        gain -= float(_gains((residual**2).ravel(), (speed**2).ravel(), even).max())
    return max(gain, 0.0), {"std": (float(sizes[size]), float(likely.min()), float(likely.max()))}, misfit


def _gains(
    square: Float64[np.ndarray, " n"], fast: Float64[np.ndarray, " n"], even: float
) -> Float64[np.ndarray, "levels sizes"]:
    """Nats by which noise of variance ``level + std^2 fast`` explains ``square`` better than even noise.

    Samples of nearly the same speed are taken together, in at most `SPEEDS` groups.
    """
    sizes, order = np.concatenate([[0.0], SIZES]), np.argsort(fast)
    begin = np.unique(np.linspace(0, len(fast), min(SPEEDS, len(fast)) + 1).astype(int))[:-1]
    n = np.diff(np.append(begin, len(fast)))
    fast, square = (np.add.reduceat(x[order], begin) / n for x in (fast, square))
    variance = (even * LEVELS)[:, None, None] + sizes[None, :, None] ** 2 * fast
    return -0.5 * np.sum(n * (square / variance + np.log(variance / even) - 1.0), axis=2)


EFFECT = SampleEffect(
    name="time_jitter",
    number=2,
    equation="y = q(t + e), e of standard deviation std",
    parameters=(EffectParameter("std", "frame", HalfNormal(0.5)),),
    needs="fast and slow stretches",
    explain=explain,
    mujoco="it concerns the time stamps of the recording, not the mechanism.",
    title="time stamps that scatter",
    what="Samples are stamped a little early or late at random.",
    symptom="Errors are large where motion is fast and vanish where it turns.",
    remedy="Use the sensor's own time stamps; leave the simulation alone.",
)
