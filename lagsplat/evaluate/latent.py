"""Latent and image error over two natural periods, in the visibility metric."""

from typing import Any

import numpy as np

from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.forecast import frame_errors, image_errors, mean_image
from lagsplat.evaluate.protocol import (
    HeldOut,
    Integrate,
    Pictures,
    Render,
    cut_windows,
    draw_starts,
    explain_shortage,
    interval_over_windows,
    roll_out_windows,
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

    The other arguments are those of `lagsplat.evaluate.forecast.image_forecast`.

    Source: paper, Metrics, latent and image error.
    """
    states = max(round(config.periods * period_s / held.dt_s), 2)
    margin = 3 if config.velocity == "forward" else 0  # as published
    if why := explain_shortage(held, length=states, margin=margin):
        return {"reason": why}
    starts = draw_starts(held, length=states, margin=margin, count=config.starts, seed=config.seed)
    q0, pinned, gone = roll_out_windows(held, integrate, starts, states, config)
    errors = frame_errors(pinned, gone, starts, pictures, render, mean_image(held, pictures))
    image, image_hold, _ = (part.mean(axis=1) for part in errors)
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
        "image_ratio": float(image.mean() / floor.mean()),
        "image_ratio_interval": interval_over_windows(
            lambda errors, floors: errors.mean(axis=-1) / floors.mean(axis=-1), image, floor, config=config
        ),
        "per_window_image": image.tolist(),
        "per_window_floor": floor.tolist(),
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
        "nrmse_interval": interval_over_windows(nrmse, error, config=config),
        "nrmse_staying": float(nrmse(error[stayed])) if stayed.any() else None,
        "nrmse_hold": float(nrmse(hold)),
        "per_window": np.sqrt(error / scale).tolist(),
    }


def state_spread(held: HeldOut) -> float:
    """Mean squared distance of the encoded states from their mean, in the visibility metric."""
    return float(squared_norm(held.encoded - held.encoded.mean(axis=0), held.metric).mean())


def state_errors(held: HeldOut, pinned: np.ndarray, gone: np.ndarray, encoded: np.ndarray) -> np.ndarray:
    """Squared error of each state of `roll_out_windows` against the ``encoded`` one; a diverged one takes the
    larger of the pinned and the mean state's.
    """
    error = squared_norm(pinned - encoded, held.metric)
    mean = squared_norm(held.encoded.mean(axis=0) - encoded, held.metric)
    return np.where(gone, np.maximum(error, mean), error)


def squared_norm(vectors: np.ndarray, metric: np.ndarray) -> np.ndarray:
    """Squared length of the vectors on the last axis, ``v^T G v``."""
    return np.einsum("...i,ij,...j->...", vectors, metric, vectors)
