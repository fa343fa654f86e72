"""The autoencoder floor: what is lost before any dynamics."""

from typing import Any

import numpy as np

from lagsplat.evaluate.protocol import HeldOut, Pictures, Render


def autoencoder_floor(held: HeldOut, pictures: Pictures, render: Render, *, most: int) -> dict[str, Any]:
    """Static reconstruction error of the unsmoothed latents, on evenly spaced held-out frames.

    Mean squared error over channels and pixels at the training resolution, colours in [0, 1]. Neighbouring
    frames err alike, so ``spread`` (standard deviation over frames) is a description and no standard error.

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
