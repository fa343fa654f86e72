"""Latent and image error over two natural periods, in the visibility metric."""

from collections.abc import Callable
from typing import Any

import numpy as np

from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.forecast import image_errors, mean_image, window_errors
from lagsplat.evaluate.protocol import (
    HeldOut,
    Integrate,
    Pictures,
    Render,
    bootstrap_interval,
    cut_windows,
    draw_starts,
    explain_shortage,
    initial_states,
    pin_diverged,
)


def latent_forecast(
    held: HeldOut,
    pictures: Pictures,
    render: Render,
    integrate: Integrate,
    config: EvaluateConfig,
    *,
    period_s: float,
) -> dict[str, Any]:
    """Latent NRMSE and image error over ``config.periods`` natural periods of ``period_s`` seconds.

    ``nrmse`` is the RMS state error over all windows and states (the initial one included) divided by the
    RMS of the encoded held-out series about its mean, both in the visibility metric without ridge;
    predicting the mean gives 1. ``image_ratio`` divides the image error by the autoencoder floor at the same
    frames. A diverged state counts with the larger error of the pinned state and of the mean state or frame.
    ``nrmse_hold`` repeats the initial state. Where no scored clip is as long as the horizon the result is
    only a ``reason``.

    Args:
        held, pictures, render, integrate, config: as `lagsplat.evaluate.forecast.image_forecast`.
        period_s: the natural period [s].

    Source: paper, Metrics, latent and image error.
    """
    states = max(round(config.periods * period_s / held.dt_s), 2)
    margin = 3 if config.velocity == "forward" else 0  # as published
    if why := explain_shortage(held, length=states, margin=margin):
        return {"reason": why}
    starts = draw_starts(held, length=states, margin=margin, count=config.starts, seed=config.seed)
    q0, v0 = initial_states(held, starts)
    steps_s = held.clock.steps_s(starts, states)
    rollouts = integrate(q0, v0, cut_windows(held.forcing, starts, states), steps_s)
    pinned, gone = pin_diverged(rollouts, bound=config.divergence_factor * held.reach)
    image, image_hold, _ = window_errors(pinned, gone, starts, pictures, render, mean_image(held, pictures))
    frames = starts[:, None] + np.arange(states)
    floor = np.array([image_errors(render(held.latents[part]), pictures(part)).mean() for part in frames])
    stayed = ~gone[:, -1]
    return {
        "period_s": float(period_s),
        "horizon_s": states * held.dt_s,
        "states": states,
        "windows": len(starts),
        "distinct": len(np.unique(starts)),
        "diverged": int((~stayed).sum()),
        "image_mse": float(image.mean()),
        "image_hold": float(image_hold.mean()),
        "floor": float(floor.mean()),
        "starts": starts.tolist(),
        **_latent_scores(held, starts, q0, pinned, gone, config),
        **_image_scores(image, floor, config),
    }


def _latent_scores(
    held: HeldOut,
    starts: np.ndarray,
    q0: np.ndarray,
    pinned: np.ndarray,
    gone: np.ndarray,
    config: EvaluateConfig,
) -> dict[str, Any]:
    encoded = cut_windows(held.encoded, starts, pinned.shape[1])
    scale = state_spread(held)
    error = state_errors(held, pinned, gone, encoded).mean(axis=1)
    hold = squared_norm(q0[:, None] - encoded, held.metric).mean(axis=1)
    stayed = ~gone[:, -1]

    def nrmse(errors: np.ndarray) -> Any:
        return np.sqrt(errors.mean(axis=-1) / scale)

    return {
        "nrmse": float(nrmse(error)),
        "nrmse_interval": _interval(nrmse, error, config=config),
        "nrmse_staying": float(nrmse(error[stayed])) if stayed.any() else None,
        "nrmse_hold": float(nrmse(hold)),
        "per_window": np.sqrt(error / scale).tolist(),
    }


def state_spread(held: HeldOut) -> float:
    """Mean squared distance of the encoded states from their mean, in the visibility metric."""
    return float(squared_norm(held.encoded - held.encoded.mean(axis=0), held.metric).mean())


def state_errors(held: HeldOut, pinned: np.ndarray, gone: np.ndarray, encoded: np.ndarray) -> np.ndarray:
    """Squared error of each state; a diverged one takes the larger of the pinned and the mean state's.

    Args:
        held, encoded: the held-out series, and the encoded states of the windows.
        pinned, gone: rollouts with diverged states pinned, and which states these are.
    """
    error = squared_norm(pinned - encoded, held.metric)
    mean = squared_norm(held.encoded.mean(axis=0) - encoded, held.metric)
    return np.where(gone, np.maximum(error, mean), error)


def _image_scores(image: np.ndarray, floor: np.ndarray, config: EvaluateConfig) -> dict[str, Any]:
    def ratio(errors: np.ndarray, floors: np.ndarray) -> Any:
        return errors.mean(axis=-1) / floors.mean(axis=-1)

    return {
        "image_ratio": float(ratio(image, floor)),
        "image_ratio_interval": _interval(ratio, image, floor, config=config),
        "per_window_image": image.tolist(),
        "per_window_floor": floor.tolist(),
    }


def _interval(statistic: Callable[..., Any], *values: np.ndarray, config: EvaluateConfig) -> list[float]:
    low, high = bootstrap_interval(
        statistic, *values, resamples=config.bootstrap, confidence=config.confidence, seed=config.seed
    )
    return [low, high]


def squared_norm(vectors: np.ndarray, metric: np.ndarray) -> np.ndarray:
    """Squared length of the vectors on the last axis, ``v^T G v``."""
    return np.einsum("...i,ij,...j->...", vectors, metric, vectors)
