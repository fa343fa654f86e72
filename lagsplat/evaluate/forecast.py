"""Errors of forecasts in images and states, and the autoencoder floor."""

import math
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float64, Int64

from lagsplat.evaluate import protocol
from lagsplat.evaluate.aggregate import group_windows, jackknife_interval
from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.protocol import EvaluationSeries, EvaluationSubject, squared_norm
from lagsplat.integer_lists import choose_evenly

BAND = (16.0, 84.0)  # percentiles over starts
LEAST = 3  # fewest states of a rollout whose error is given over time


class ForecastWindows(NamedTuple):
    """Rollouts from several starts with diverged states pinned, which states these are, and image errors.

    ``error`` is that of the rollout, ``hold`` that of repeating the first recorded frame and ``mean`` that of
    the mean frame. A diverged state scores the larger of two errors, that of the state pinned at the
    divergence bound and that of the mean frame, so that divergence never lowers a mean.
    """

    states: Float64[np.ndarray, "B N d"]
    gone: Bool[np.ndarray, "B N"]
    error: Float64[np.ndarray, "B N"]
    hold: Float64[np.ndarray, "B N"]
    mean: Float64[np.ndarray, "B N"]


def forecast_windows(
    subject: EvaluationSubject, starts: Int64[np.ndarray, " B"], states: int, config: EvaluateConfig
) -> ForecastWindows:
    """Rollouts of so many ``states`` from the starts, with their image errors.

    The mean frame is that of up to 256 evenly spaced recorded frames of the scored part.
    """
    held, pictures = subject.held, subject.pictures
    rollouts = protocol.roll_out(held, subject.integrate, starts, states)
    pinned, gone = protocol.pin_diverged(rollouts, bound=config.divergence_factor * held.reach)
    mean_frame = pictures(np.linspace(held.skip, held.n_frames - 1, 256).astype(np.int64)).mean(axis=0)
    rows = []
    for path, lost, start in zip(pinned, gone, starts, strict=True):
        recorded = pictures(start + np.arange(states))
        mean = image_errors(np.broadcast_to(mean_frame, recorded.shape), recorded)
        error = image_errors(subject.render(path), recorded)
        hold = image_errors(np.broadcast_to(recorded[:1], recorded.shape), recorded)
        rows.append((np.where(lost, np.maximum(error, mean), error), hold, mean))
    return ForecastWindows(pinned, gone, *np.moveaxis(np.array(rows, dtype=np.float64), 1, 0))


def image_forecast(subject: EvaluationSubject, config: EvaluateConfig) -> dict[str, Any]:
    """Image error of short rollouts: state i against recorded frame s + i, the initial state included.

    ``mse`` averages over every window, diverged ones scored as in `ForecastWindows`; ``diverged`` counts
    these and ``mse_staying`` is the mean over the others (as published). ``mse_ahead`` leaves the initial
    state out and counts as many after it. ``hold`` repeats the first recorded frame, the error that a useful
    forecast must beat. ``per_window`` belongs to ``starts`` one to one, for paired comparisons.

    Source: paper, Metrics; the 0.5 s image MSE of the Krauss benchmark.
    """
    held = subject.held
    states = round(config.horizon_s / held.dt_s)
    starts = protocol.draw_starts(held, length=states, margin=0, count=config.starts, seed=config.seed)
    # ``mse_ahead`` needs one state more than the horizon; starts leave space for it.
    windows = forecast_windows(subject, starts, states + 1, config)
    error, hold, mean = (
        part[:, :states].mean(axis=1) for part in (windows.error, windows.hold, windows.mean)
    )
    ahead = windows.error[:, 1:].mean(axis=1)
    groups = group_windows(starts, states)
    interval = partial(jackknife_interval, groups=groups, confidence=config.confidence, positive=True)
    low, high = interval(float, error)
    stayed = ~windows.gone[:, states - 1]
    return {
        "horizon_s": states * held.dt_s,
        "states": states,
        "windows": len(starts),
        "distinct": int(groups.max()) + 1,
        "mse": float(error.mean()),
        "low": low,
        "high": high,
        "mse_ahead": float(ahead.mean()),
        "ahead_interval": interval(float, ahead),
        "diverged": int((~stayed).sum()),
        "mse_staying": float(error[stayed].mean()) if stayed.any() else None,
        "hold": float(hold.mean()),
        "mean_frame": float(mean.mean()),
        "starts": starts.tolist(),
        "per_window": error.tolist(),
        "per_window_ahead": ahead.tolist(),
        "per_window_hold": hold.tolist(),
    }


def latent_forecast(subject: EvaluationSubject, config: EvaluateConfig, *, period_s: float) -> dict[str, Any]:
    """Latent NRMSE and image error over ``config.periods`` natural periods of ``period_s`` seconds.

    ``nrmse`` is the RMS state error over all windows and states (the initial one included) divided by the
    RMS of the held-out series about its mean, both as encoded and in the visibility metric without ridge;
    predicting the mean gives 1. ``image_ratio`` divides the image error by the autoencoder floor at the same
    frames. A diverged state counts with the larger error of the pinned state and of the mean state or frame.
    ``nrmse_hold`` repeats the initial state. Where no scored clip is as long as the horizon the result is
    only a ``reason``.

    Source: paper, Metrics, latent and image error.
    """
    held = subject.held
    states = max(round(config.periods * period_s / held.dt_s), 2)
    margin = 3 if config.velocity == "forward" else 0  # as published
    if why := protocol.explain_shortage(held, length=states, margin=margin):
        return {"reason": why}
    starts = protocol.draw_starts(held, length=states, margin=margin, count=config.starts, seed=config.seed)
    windows = forecast_windows(subject, starts, states, config)
    stayed = ~windows.gone[:, -1]
    image = windows.error.mean(axis=1)
    floor = np.array([_floor_errors(subject, start + np.arange(states)).mean() for start in starts])
    encoded, scale = protocol.cut_windows(held.latents, starts, states), state_spread(held)
    groups = group_windows(starts, states)
    error = state_errors(held, windows.states, windows.gone, encoded).mean(axis=1)
    hold = squared_norm(encoded[:, :1] - encoded, held.metric).mean(axis=1)

    def nrmse(mean: float) -> float:
        return math.sqrt(mean / scale)

    interval = partial(jackknife_interval, groups=groups, confidence=config.confidence, positive=True)
    return {
        "period_s": float(period_s),
        "horizon_s": states * held.dt_s,
        "states": states,
        "windows": len(starts),
        "distinct": int(groups.max()) + 1,
        "diverged": int((~stayed).sum()),
        "image_mse": float(image.mean()),
        "image_hold": float(windows.hold.mean(axis=1).mean()),
        "floor": float(floor.mean()),
        "starts": starts.tolist(),
        "nrmse": nrmse(error.mean()),
        "nrmse_interval": interval(nrmse, error),
        "nrmse_staying": nrmse(error[stayed].mean()) if stayed.any() else None,
        "nrmse_hold": nrmse(hold.mean()),
        "per_window": np.sqrt(error / scale).tolist(),
        "image_ratio": float(image.mean() / floor.mean()),
        "image_ratio_interval": interval(lambda a, b: a / b, image, floor),
        "per_window_image": image.tolist(),
        "per_window_floor": floor.tolist(),
    }


def state_spread(held: EvaluationSeries) -> float:
    """Mean squared distance of the encoded states from their mean, in the visibility metric."""
    return float(squared_norm(held.latents - held.latents.mean(axis=0), held.metric).mean())


def state_errors(
    held: EvaluationSeries, pinned: np.ndarray, gone: np.ndarray, encoded: np.ndarray
) -> np.ndarray:
    """Squared error of each state against the ``encoded`` one; a diverged one takes the larger of the pinned
    and the mean state's.
    """
    error = squared_norm(pinned - encoded, held.metric)
    mean = squared_norm(held.latents.mean(axis=0) - encoded, held.metric)
    return np.where(gone, np.maximum(error, mean), error)


def error_over_horizon(subject: EvaluationSubject, config: EvaluateConfig) -> dict[str, Any]:
    """Image error at each moment of rollouts of ``config.figure.horizon_s``, or of half the longest clip.

    ``median``, ``low`` and ``high`` (the central two thirds) are over ``config.figure.horizon_starts``
    starts; ``hold`` and ``mean_frame`` are the medians of repeating the first frame and of the mean frame.
    """
    held = subject.held
    first, stop = held.longest
    # Half a clip leaves enough frames for different starts.
    states = min(round(config.figure.horizon_s / held.dt_s), (stop - first) // 2)
    if states < LEAST:
        return {"reason": f"the longest scored clip has {stop - first} frames; hold out more"}
    count = config.figure.horizon_starts
    starts = protocol.draw_starts(held, length=states, margin=0, count=count, seed=config.seed)
    windows = forecast_windows(subject, starts, states, config)
    low, high = np.percentile(windows.error, BAND, axis=0)
    return {
        "time_s": (held.dt_s * np.arange(states)).tolist(),
        "median": np.median(windows.error, axis=0).tolist(),
        "low": low.tolist(),
        "high": high.tolist(),
        "hold": np.median(windows.hold, axis=0).tolist(),
        "mean_frame": np.median(windows.mean, axis=0).tolist(),
        "diverged": windows.gone.mean(axis=0).tolist(),
        "starts": starts.tolist(),
    }


def measure_autoencoder_floor(subject: EvaluationSubject, *, most: int) -> dict[str, Any]:
    """Static reconstruction error of the unsmoothed latents, on at most ``most`` evenly spaced frames.

    Errors of neighbouring frames are correlated, so ``spread`` (standard deviation) is not a standard error.

    Source: paper, Metrics, the AE floor.
    """
    held = subject.held
    frames = held.skip + choose_evenly(held.n_frames - held.skip, most)
    parts = np.array_split(frames, max(1, len(frames) // 64))
    errors = np.concatenate([_floor_errors(subject, part) for part in parts])
    return {
        "value": float(errors.mean()),
        "spread": float(errors.std()),
        "p05": float(np.percentile(errors, 5)),
        "p95": float(np.percentile(errors, 95)),
        "frames": len(frames),
    }


def _floor_errors(subject: EvaluationSubject, frames: np.ndarray) -> np.ndarray:
    return image_errors(subject.render(subject.held.latents[frames]), subject.pictures(frames))


def image_errors(rendered: np.ndarray, recorded: np.ndarray) -> np.ndarray:
    """Mean squared error of each image over channels and pixels, colours and clamped renders in [0, 1].

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
