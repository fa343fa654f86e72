"""Frames of a film, blurred, with their gradients, read between pixels."""

import copy
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from scipy.ndimage import gaussian_filter
from torch import Tensor

from lagsplat.array_types import Frames


class Samples(NamedTuple):
    """Colours at some places of some frames, their gradients [1/px], and which places are in the image."""

    color: Float[Tensor, "B P 3"]
    gradient: Float[Tensor, "B P 3 2"]
    inside: Bool[Tensor, "B P"]


class BlurredFilm:
    """Frames, blurred by a Gaussian.

    Args:
        frames: of which each is read alone.
        blur_px: standard deviation of the Gaussian [px]: a body is found from about as far as it blurs.
    """

    def __init__(self, frames: Frames, *, blur_px: float) -> None:
        colors = blur_frames(frames, blur_px=blur_px)
        down, across = np.gradient(colors, axis=(1, 2))
        channels = np.concatenate([colors, across, down], axis=3)
        self.channels = torch.from_numpy(channels).permute(0, 3, 1, 2).contiguous()

    def select(self, frames: Int[Tensor, " B"]) -> "BlurredFilm":
        """The film of some of the frames."""
        selected = copy.copy(self)
        selected.channels = self.channels[frames]
        return selected

    def sample(self, frames: slice, places: Float[Tensor, "B P 2"]) -> Samples:
        """Read each of ``frames`` at its places [px] by bicubic interpolation."""
        size = torch.tensor(self.channels.shape[:1:-1], dtype=places.dtype)
        grid = (2.0 * places / size - 1.0).float()[:, :, None]
        read = torch.nn.functional.grid_sample(
            self.channels[frames], grid, mode="bicubic", padding_mode="border", align_corners=False
        )
        values = read[..., 0].mT.double()
        inside = ((places > 0.0) & (places < size)).all(2)
        return Samples(values[..., :3], torch.stack([values[..., 3:6], values[..., 6:]], 3), inside)


def blur_frames(frames: Frames, *, blur_px: float) -> Float[np.ndarray, "T H W 3"]:
    """Frames with colours in [0, 1], blurred."""
    return gaussian_filter(frames.astype(np.float32) / 255.0, (0, blur_px, blur_px, 0), mode="nearest")
