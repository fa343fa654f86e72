"""The image error along long rollouts: where a forecast stops being one."""

from typing import Any

import numpy as np

from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.forecast import frame_errors, mean_picture
from lagsplat.evaluate.protocol import (
    HeldOut,
    Integrate,
    Pictures,
    Render,
    draw_starts,
    initial_states,
    pin_diverged,
    windows,
)

BAND = (16.0, 84.0)  # percentiles over starts
LEAST = 3


def error_along(
    held: HeldOut, pictures: Pictures, render: Render, integrate: Integrate, config: EvaluateConfig
) -> dict[str, Any]:
    """Image error at each moment of rollouts of ``config.figure.horizon_s``, or of half the longest clip.

    ``median``, ``low`` and ``high`` (the central two thirds) are over ``config.figure.horizon_starts``
    starts, ``hold`` and ``mean_frame`` are the medians of holding the first frame and of the mean frame.
    Diverged states count as in the forecast.
    """
    first, stop = held.longest
    # Half a clip leaves room for starts that differ.
    states = min(round(config.figure.horizon_s / held.dt_s), (stop - first) // 2)
    if states < LEAST:
        return {"reason": f"the longest scored clip has {stop - first} frames; hold out more"}
    count = config.figure.horizon_starts
    starts = draw_starts(held, length=states, margin=0, count=count, seed=config.seed)
    q0, v0 = initial_states(held, starts)
    rollouts = integrate(q0, v0, windows(held.forcing, starts, states), held.clock.steps_s(starts, states))
    pinned, gone = pin_diverged(rollouts, bound=config.divergence_factor * held.reach)
    average = mean_picture(held, pictures)
    error, hold, mean = frame_errors(pinned, gone, starts, pictures, render, average)
    low, high = np.percentile(error, BAND, axis=0)
    return {
        "time_s": (held.dt_s * np.arange(states)).tolist(),
        "median": np.median(error, axis=0).tolist(),
        "low": low.tolist(),
        "high": high.tolist(),
        "hold": np.median(hold, axis=0).tolist(),
        "mean_frame": np.median(mean, axis=0).tolist(),
        "diverged": gone.mean(axis=0).tolist(),
        "starts": starts.tolist(),
    }
