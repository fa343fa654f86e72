"""Errors of forecast images, the autoencoder floor, and the clip on which extrapolation is measured."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.chart.chart import Chart
from lagsplat.chart.trajectory import TimeBase
from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.modes import fit_modes
from lagsplat.evaluate.protocol import (
    HeldOut,
    Integrate,
    Pictures,
    Render,
    draw_starts,
    interval_over_windows,
    roll_out_windows,
)
from lagsplat.evaluate.spectrum import resample_evenly
from lagsplat.io.recording.segments import find_crossing_frames


def image_forecast(
    held: HeldOut, pictures: Pictures, render: Render, integrate: Integrate, config: EvaluateConfig
) -> dict[str, Any]:
    """Image error of short rollouts: state i against recorded frame s + i, the initial state included.

    ``mse`` averages over every window. After divergence a state scores the larger of two errors, that of the
    state pinned at the divergence bound and that of the mean frame, so that divergence never lowers the
    mean; ``diverged`` counts such windows and ``mse_staying`` is the mean over the others (as published).
    ``mse_ahead`` leaves the initial state out and counts as many after it. ``hold`` repeats the first
    recorded frame, the error that a useful forecast must beat. ``per_window`` belongs to ``starts`` one to
    one, for paired comparisons.

    Args:
        held, pictures, config: the held-out series, its recorded images, and the evaluation protocol.
        render, integrate: renderer and rollout of the model.

    Source: paper, Metrics; the 0.5 s image MSE of the Krauss benchmark.
    """
    states = round(config.horizon_s / held.dt_s)
    starts = draw_starts(held, length=states, margin=0, count=config.starts, seed=config.seed)
    # ``mse_ahead`` needs one state more than the horizon; starts leave space for it.
    _, pinned, gone = roll_out_windows(held, integrate, starts, states + 1, config)
    parts = frame_errors(pinned, gone, starts, pictures, render, mean_image(held, pictures))
    error, hold, mean = (part[:, :states].mean(axis=1) for part in parts)
    ahead, gone = parts[0][:, 1:].mean(axis=1), gone[:, :states]
    (low, high), ahead_interval = (
        interval_over_windows(lambda values: values.mean(axis=-1), values, config=config)
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
        "ahead_interval": ahead_interval,
        "diverged": int((~stayed).sum()),
        "mse_staying": float(error[stayed].mean()) if stayed.any() else None,
        "hold": float(hold.mean()),
        "mean_frame": float(mean.mean()),
        "starts": starts.tolist(),
        "per_window": error.tolist(),
        "per_window_ahead": ahead.tolist(),
        "per_window_hold": hold.tolist(),
    }


def mean_image(held: HeldOut, pictures: Pictures) -> np.ndarray:
    """Mean of up to 256 evenly spaced recorded frames of the scored part."""
    return pictures(np.linspace(held.skip, held.n_frames - 1, 256).astype(np.int64)).mean(axis=0)


def frame_errors(
    pinned: np.ndarray,
    gone: np.ndarray,
    starts: np.ndarray,
    pictures: Pictures,
    render: Render,
    mean_frame: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Image errors (B, N): of the rollout, of repeating the first frame, of the mean frame.

    Args:
        pinned, gone: rollouts with diverged states pinned, and which states these are.
        starts: first frame of each window.
        pictures, render, mean_frame: recorded images, renderer, and mean of the recorded images.
    """
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
    """Standard error of a mean over windows, or None for a single window."""
    return float(values.std(ddof=1) / np.sqrt(len(values))) if len(values) > 1 else None


BAND = (16.0, 84.0)  # percentiles over starts
LEAST = 3


def error_over_horizon(
    held: HeldOut, pictures: Pictures, render: Render, integrate: Integrate, config: EvaluateConfig
) -> dict[str, Any]:
    """Image error at each moment of rollouts of ``config.figure.horizon_s``, or of half the longest clip.

    ``median``, ``low`` and ``high`` (the central two thirds) are over ``config.figure.horizon_starts``
    starts; ``hold`` and ``mean_frame`` are the medians of repeating the first frame and of the mean frame.
    Arguments and diverged states are as in `image_forecast`.
    """
    first, stop = held.longest
    # Half a clip leaves enough frames for different starts.
    states = min(round(config.figure.horizon_s / held.dt_s), (stop - first) // 2)
    if states < LEAST:
        return {"reason": f"the longest scored clip has {stop - first} frames; hold out more"}
    count = config.figure.horizon_starts
    starts = draw_starts(held, length=states, margin=0, count=count, seed=config.seed)
    _, pinned, gone = roll_out_windows(held, integrate, starts, states, config)
    errors = frame_errors(pinned, gone, starts, pictures, render, mean_image(held, pictures))
    error, hold, mean = errors
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


@dataclass(frozen=True)
class BoundaryClip:
    """Latents of one clip, not smoothed: frames ``start`` to ``stop`` of the recording, of which those from
    ``boundary`` on are held out. ``period_s`` [s] is the natural period of its training part.
    """

    start: int
    boundary: int
    stop: int
    dt_s: float
    period_s: float
    latents: Float64[np.ndarray, "T d"]
    time_s: Float64[np.ndarray, " T"]
    metric: Float64[np.ndarray, "d d"]
    even: bool

    @property
    def n_train(self) -> int:
        """Number of training frames in the clip."""
        return self.boundary - self.start

    @property
    def ahead(self) -> Float64[np.ndarray, " held"]:
        """Instants of the held-out frames, in median spacings from the last training frame."""
        return self.places[self.n_train :] - self.places[self.n_train - 1]

    @property
    def places(self) -> Float64[np.ndarray, " T"]:
        """Instants of all frames, in median spacings from the first."""
        return (self.time_s - self.time_s[0]) / self.dt_s

    @property
    def clock(self) -> TimeBase:
        """The time base of the frames."""
        return TimeBase(self.dt_s, None if self.even else self.time_s)

    def history(self, periods: float) -> int:
        """Number of training frames in this many natural periods: at least four, at most all."""
        return int(np.clip(round(periods * self.period_s / self.dt_s), min(4, self.n_train), self.n_train))


def choose_boundary_clip(chart: Chart) -> BoundaryClip:
    """The clip of a chart that holds both training and held-out frames.

    Raises:
        ValueError: there is none, the mechanism is driven, or its training part shows no oscillation.
    """
    start, boundary, stop = find_crossing_frames(chart.segments, chart.n_train)
    if chart.inputs.shape[1] and np.ptp(chart.inputs[start:stop], axis=0).max() > 0:
        raise ValueError(
            "the clip is driven by inputs, and a forecaster of pictures knows none; take a free system"
        )
    latents, clock = chart.latents[start:stop], chart.whole.clock
    whole = chart.whole.part(start, stop)
    train = resample_evenly(latents[: boundary - start], clock, start=start)
    modes = fit_modes(train, dt_s=chart.dt_s, metric=chart.metric, most=1)
    if not modes:
        raise ValueError("the training part of the clip shows no oscillation to take a natural period from")
    return BoundaryClip(
        start=start,
        boundary=boundary,
        stop=stop,
        dt_s=chart.dt_s,
        period_s=1.0 / modes[0].frequency_hz,
        latents=latents,
        time_s=whole.time_s,
        metric=chart.metric,
        even=clock.time_s is None,
    )


def measure_autoencoder_floor(
    held: HeldOut, pictures: Pictures, render: Render, *, most: int
) -> dict[str, Any]:
    """Static reconstruction error of the unsmoothed latents, on at most ``most`` evenly spaced frames.

    Mean squared error over channels and pixels at the training resolution, colours in [0, 1]. Errors of
    neighbouring frames are correlated, so ``spread`` (standard deviation) is not a standard error.

    Source: paper, Metrics, the AE floor.
    """
    available = held.n_frames - held.skip
    chosen = np.unique(
        np.linspace(held.skip, held.n_frames - 1, min(most, available)).round().astype(np.int64)
    )
    errors = np.concatenate(
        [
            image_errors(render(held.latents[part]), pictures(part))
            for part in np.array_split(chosen, max(1, len(chosen) // 64))
        ]
    )
    return {
        "value": float(errors.mean()),
        "spread": float(errors.std()),
        "p05": float(np.percentile(errors, 5)),
        "p95": float(np.percentile(errors, 95)),
        "frames": len(chosen),
    }


def image_errors(rendered: np.ndarray, recorded: np.ndarray) -> np.ndarray:
    """Mean squared error of each image over channels and pixels; renders are clamped to [0, 1].

    Raises:
        ValueError: the two stacks differ in shape.
    """
    if rendered.shape != recorded.shape:
        raise ValueError(
            f"renders of shape {rendered.shape} against recorded images of shape {recorded.shape}: the "
            "autoencoder was trained at another resolution; evaluate it on its own recording"
        )
    residual = np.clip(rendered, 0.0, 1.0, dtype=np.float64) - recorded
    return np.mean(residual**2, axis=(1, 2, 3))
