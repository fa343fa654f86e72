"""Whether predicted frames are still of the kind the encoder knows: else its word means nothing."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float32, Float64
from scipy.spatial import cKDTree

from lagsplat.chart.chart import Chart
from lagsplat.evaluate.extrapolation_config import ExtrapolationConfig
from lagsplat.evaluate.floor import image_errors
from lagsplat.evaluate.protocol import Pictures
from lagsplat.stage1.autoencoder import CHUNK, Autoencoder, decode_latents

MOST = 1000  # training frames that say how well the autoencoder reproduces what it knows


@dataclass(frozen=True)
class Known:
    """What the encoder has seen: its training states and how badly it reproduces its worst training frame.

    ``scale`` is the rms of the training states about their mean, in the metric, in which distances count.
    """

    autoencoder: Autoencoder
    chart: Chart
    worst_error: float
    scale: float
    root: Float64[np.ndarray, "d d"]
    tree: cKDTree

    def to_states(self, images: Float32[np.ndarray, "N 3 H W"]) -> Float64[np.ndarray, "N d"]:
        """Whitened latents of images in [0, 1].

        Raises:
            ValueError: the images are of another size than the encoder's.
        """
        size = (self.autoencoder.height, self.autoencoder.width)
        if images.shape[2:] != size:
            raise ValueError(
                f"predicted frames of {images.shape[2]} x {images.shape[3]} pixels, but the encoder was "
                f"trained on {size[0]} x {size[1]}; predict frames of the size that was trained on"
            )
        device = next(self.autoencoder.parameters()).device
        with torch.no_grad():
            parts = [
                self.autoencoder.encode(part.to(device)).double().cpu()
                for part in torch.from_numpy(np.clip(images, 0.0, 1.0)).split(CHUNK)
            ]
        return self.chart.to_whitened(torch.cat(parts).numpy())


@dataclass(frozen=True)
class Reading:
    """States read off predicted frames, and which of these are in range.

    ``error`` is the mean squared reconstruction error of each frame over that of the worst training frame,
    ``distance`` how far its state lies from the nearest training state, over the rms of these.
    """

    states: Float64[np.ndarray, "N d"]
    error: Float64[np.ndarray, " N"]
    distance: Float64[np.ndarray, " N"]
    inside: Bool[np.ndarray, " N"]


def known_to(autoencoder: Autoencoder, chart: Chart, pictures: Pictures) -> Known:
    """What an autoencoder knows of its recording; ``pictures`` gives its training frames by number."""
    chosen = np.unique(np.linspace(0, chart.n_train - 1, min(MOST, chart.n_train)).round().astype(np.int64))
    states = chart.train.latents
    errors = [
        image_errors(decode_latents(autoencoder, chart.to_raw(states[part])), pictures(part)).max()
        for part in np.array_split(chosen, max(1, len(chosen) // CHUNK))
    ]
    values, vectors = np.linalg.eigh(chart.metric)
    root = vectors * np.sqrt(np.clip(values, 0.0, None))
    seen = states @ root
    scale = float(np.sqrt(np.square(seen - seen.mean(axis=0)).sum(axis=1).mean()))
    return Known(autoencoder, chart, float(max(errors)), scale, root, cKDTree(seen))


def read(known: Known, images: Float32[np.ndarray, "N 3 H W"], config: ExtrapolationConfig) -> Reading:
    """Encode predicted images and see whether each is in range.

    Raises:
        ValueError: the images are of another size than the encoder's.

    Source: paper, "What the Lagrangian prior buys": the reading means something only while the encoder is fed
    images it can make sense of.
    """
    states = known.to_states(images)
    drawn = decode_latents(known.autoencoder, known.chart.to_raw(states))
    error = image_errors(drawn, np.clip(images, 0.0, 1.0)) / max(known.worst_error, 1e-12)
    distance = known.tree.query(states @ known.root)[0] / known.scale
    inside = (error <= config.range_error) & (distance <= config.range_distance)
    return Reading(states, error, distance, inside)


def told(readings: list[Reading]) -> dict[str, Any]:
    """How far the frames of several readings stay in range, as plain data."""
    error, distance, inside = (
        np.concatenate([getattr(reading, name) for reading in readings])
        for name in ("error", "distance", "inside")
    )
    return {
        "frames": len(inside),
        "inside": float(inside.mean()),
        "worst_error": float(error.max()),
        "median_error": float(np.median(error)),
        "worst_distance": float(distance.max()),
    }
