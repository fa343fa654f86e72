"""The half-second image forecast of the benchmark, over many starts."""

from typing import Any

import numpy as np

from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.floor import image_errors
from lagsplat.evaluate.protocol import (
    HeldOut,
    Integrate,
    Pictures,
    Render,
    bootstrap_interval,
    draw_starts,
    initial_states,
    pin_diverged,
    windows,
)


def image_forecast(
    held: HeldOut, pictures: Pictures, render: Render, integrate: Integrate, config: EvaluateConfig
) -> dict[str, Any]:
    """Image error of short rollouts: state i against recorded frame s + i, the initial state included.

    ``mse`` averages over every window. From the moment a rollout diverges its states are scored with the
    larger of two errors, of its state pinned at the divergence bound and of the mean frame, so that no
    divergence is dropped and none lowers the mean; ``diverged`` counts such windows and ``mse_staying`` is
    the mean over the others (the published treatment). ``mse_ahead`` counts as many states after the initial
    one, which is not scored: all of them are forecasts. ``hold`` repeats the recorded first frame: a forecast
    that does not beat it has learned nothing. ``per_window`` belongs to ``starts`` one to one, for paired
    comparisons.

    Source: paper, Metrics; the 0.5 s image MSE of the Krauss benchmark.
    """
    states = round(config.horizon_s / held.dt_s)
    starts = draw_starts(held, length=states, margin=0, count=config.starts, seed=config.seed)
    q0, v0 = initial_states(held, starts)
    # One state more than the horizon has, for the other way of counting; starts leave room for it.
    steps_s = held.clock.steps_s(starts, states + 1)
    rollouts = integrate(q0, v0, windows(held.forcing, starts, states + 1), steps_s)
    pinned, gone = pin_diverged(rollouts, bound=config.divergence_factor * held.reach)
    average = mean_picture(held, pictures)
    parts = frame_errors(pinned, gone, starts, pictures, render, average)
    error, hold, mean = (part[:, :states].mean(axis=1) for part in parts)
    ahead, gone = parts[0][:, 1:].mean(axis=1), gone[:, :states]
    (low, high), ahead_interval = (
        bootstrap_interval(
            lambda values: values.mean(axis=-1),
            values,
            resamples=config.bootstrap,
            confidence=config.confidence,
            seed=config.seed,
        )
        for values in (error, ahead)
    )
    stayed = ~gone[:, -1]
    return {
        "horizon_s": states * held.dt_s,
        "states": states,
        "windows": len(starts),
        "mse": float(error.mean()),
        "low": low,
        "high": high,
        "standard_error": standard_error(error),
        "mse_ahead": float(ahead.mean()),
        "ahead_interval": list(ahead_interval),
        "diverged": int((~stayed).sum()),
        "mse_staying": float(error[stayed].mean()) if stayed.any() else None,
        "hold": float(hold.mean()),
        "mean_frame": float(mean.mean()),
        "starts": starts.tolist(),
        "per_window": error.tolist(),
        "per_window_ahead": ahead.tolist(),
        "per_window_hold": hold.tolist(),
    }


def mean_picture(held: HeldOut, pictures: Pictures) -> np.ndarray:
    """Mean of up to 256 evenly spaced recorded frames of the scored part."""
    return pictures(np.linspace(held.skip, held.n_frames - 1, 256).astype(np.int64)).mean(axis=0)


def window_errors(
    pinned: np.ndarray,
    gone: np.ndarray,
    starts: np.ndarray,
    pictures: Pictures,
    render: Render,
    mean_frame: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Image errors of each window: of the rollout, of holding the first frame, of the mean frame."""
    parts = frame_errors(pinned, gone, starts, pictures, render, mean_frame)
    error, hold, mean = (part.mean(axis=1) for part in parts)
    return error, hold, mean


def frame_errors(
    pinned: np.ndarray,
    gone: np.ndarray,
    starts: np.ndarray,
    pictures: Pictures,
    render: Render,
    mean_frame: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same for each frame of each window, (B, N) each."""
    rows = []
    for states, lost, start in zip(pinned, gone, starts, strict=True):
        recorded = pictures(start + np.arange(len(states)))
        mean = image_errors(np.broadcast_to(mean_frame, recorded.shape), recorded)
        error = image_errors(render(states), recorded)
        error = np.where(lost, np.maximum(error, mean), error)
        hold = image_errors(np.broadcast_to(recorded[:1], recorded.shape), recorded)
        rows.append((error, hold, mean))
    error, hold, mean = np.moveaxis(np.array(rows, dtype=np.float64), 1, 0)
    return error, hold, mean


def standard_error(values: np.ndarray) -> float | None:
    """Standard error of a mean over windows, or None when one window has no spread."""
    return float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else None
