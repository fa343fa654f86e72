"""Frames of one camera, blurred, with their gradients, read where the camera sees points between pixels."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, UInt8
from scipy.ndimage import gaussian_filter
from torch import Tensor

from lagsplat.array_types import Frames
from lagsplat.splat.projection import NEAR
from lagsplat.views.camera import Camera
from lagsplat.views.novel import KNOWN

MOSTLY = 0.9  # known share of what a blurred pixel shows from which on it is known; set by hand


@dataclass(frozen=True)
class CameraFilm:
    """What one camera filmed.

    Args:
        frames: of which each is read alone.
        camera: in the coordinates of material points; None where these are pixels of the frames.
        cover: known share of a pixel in [0, 255]; None if all is known.
    """

    frames: Frames
    camera: Camera | None = None
    cover: UInt8[np.ndarray, "T H W"] | None = None


class Samples(NamedTuple):
    """Colours at some points in some frames, their gradients [1/px], and which points the frames show.

    From several films, they have an axis ``C`` of cameras after that of the frames.
    """

    color: Float[Tensor, "B *C P 3"]
    gradient: Float[Tensor, "B *C P 3 n"]
    inside: Bool[Tensor, "B *C P"]


class BlurredFilm:
    """Blurred frames of one camera.

    Args:
        colors: of the frames, which may be any numbers.
        camera: see `CameraFilm`.
        share: known share of what each pixel shows; None if all is known.
    """

    def __init__(
        self,
        colors: Float32[Tensor, "T 3 H W"],
        camera: Camera | None,
        share: Float32[Tensor, "T 1 H W"] | None,
    ) -> None:
        down, across = torch.gradient(colors, dim=(2, 3))
        self.channels = torch.cat([colors, across, down, *([] if share is None else [share])], 1)
        self.camera = camera

    def sample(self, frames: slice, points: Float[Tensor, "B P n"]) -> Samples:
        """Read each of ``frames`` where the camera sees its points [px], by bicubic interpolation."""
        places, slope = (points, None) if self.camera is None else project_points(self.camera, points)
        size = torch.tensor(self.channels.shape[:1:-1], dtype=places.dtype)
        grid = (2.0 * places / size - 1.0).float()[:, :, None]
        read = torch.nn.functional.grid_sample(
            self.channels[frames], grid, mode="bicubic", padding_mode="border", align_corners=False
        )
        values = read[..., 0].mT.double()
        inside = ((places > 0.0) & (places < size)).all(2) & (values[..., 9:] > MOSTLY).all(2)
        gradient = torch.stack([values[..., 3:6], values[..., 6:9]], 3)
        return Samples(values[..., :3], gradient if slope is None else gradient @ slope, inside)


def sample_films(films: Sequence[BlurredFilm], frames: slice, points: Float[Tensor, "B P n"]) -> Samples:
    """Read the same frames of several cameras at the same points."""
    seen = [film.sample(frames, points) for film in films]
    return Samples(*(torch.stack(part, 1) for part in zip(*seen, strict=True)))


def project_points(
    camera: Camera, points: Float[Tensor, "*B 3"]
) -> tuple[Float[Tensor, "*B 2"], Float[Tensor, "*B 2 3"]]:
    """Image coordinates [px] of points, and their derivatives; outside the image for points behind it."""
    turn, focal = torch.from_numpy(camera.rotation), points.new_tensor(camera.focal)
    seen = (points - torch.from_numpy(camera.position)) @ turn.T
    ahead = seen[..., 2:] > NEAR
    depth = seen[..., 2:].where(ahead, 1.0)
    offset = seen[..., :2] / depth
    places = (focal * offset + points.new_tensor(camera.middle)).where(ahead, -1.0)
    slope = (focal / depth)[..., None] * (turn[:2] - offset[..., None] * turn[2])
    return places, slope


def blur_frames(
    film: CameraFilm, *, blur_px: float
) -> tuple[Float32[np.ndarray, "T H W 3"], Float32[np.ndarray, "T H W"] | None]:
    """Frames with colours in [0, 1], blurred, and the known share of what each pixel then shows.

    Args:
        film: What is unknown of it takes no part; None is returned if all is known.
        blur_px: standard deviation of the Gaussian [px]: a body is found from about as far as it blurs.
    """
    colors = film.frames.astype(np.float32) / 255.0
    over = (0, blur_px, blur_px)
    if film.cover is None:
        return gaussian_filter(colors, (*over, 0), mode="nearest"), None
    known = (film.cover > 255 * KNOWN).astype(np.float32)
    share = gaussian_filter(known, over, mode="nearest")
    blurred = gaussian_filter(colors * known[..., None], (*over, 0), mode="nearest")
    return blurred / share.clip(min=1e-3)[..., None], share
