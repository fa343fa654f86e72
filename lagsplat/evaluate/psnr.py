"""Peak signal-to-noise ratios of predicted frames, as they come and with their phase taken out."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.evaluate.floor import image_errors

Draw = Callable[[np.ndarray], np.ndarray]
"""Instants in frames since the last training frame (N,), fractions allowed -> images (N,3,H,W) in [0, 1]."""
LEAST_ERROR = 1e-10


def decibels(errors: Float64[np.ndarray, " N"]) -> Float64[np.ndarray, " N"]:
    """PSNR [dB] of mean squared errors of colours in [0, 1]; at most 100."""
    return -10.0 * np.log10(np.maximum(errors, LEAST_ERROR))


def held_out_psnr(draw: Draw, recorded: np.ndarray, ahead: np.ndarray) -> dict[str, Any]:
    """PSNR [dB] of each predicted frame against the ``recorded`` (N,3,H,W): mean, first, last and all.

    ``ahead`` are the instants of the recorded frames, in frames since the last training frame.

    Source: paper, Table "Extrapolation past the training window".
    """
    values = decibels(image_errors(draw(ahead), recorded))
    return _summary(values)


def aligned_psnr(
    draw: Draw, recorded: np.ndarray, ahead: np.ndarray, *, shifts: Float64[np.ndarray, " S"]
) -> dict[str, Any]:
    """The same with each recorded frame held against the best of those shown ``shifts`` frames later.

    What is lost only because the model is ahead or behind does not count: what is left is rendering.
    ``shift`` are the chosen shifts, so that a growing lag shows.
    """
    values = np.stack([decibels(image_errors(draw(ahead + shift), recorded)) for shift in shifts])
    best = values.argmax(axis=0)
    return {**_summary(values.max(axis=0)), "shift": shifts[best].tolist()}


def _summary(values: np.ndarray) -> dict[str, Any]:
    return {
        "mean": float(values.mean()),
        "first": float(values[0]),
        "last": float(values[-1]),
        "per_frame": values.tolist(),
    }
