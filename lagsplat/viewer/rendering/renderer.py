"""Draws states of a run at any size, from the recording camera or, in space, from any other."""

import numpy as np
import torch
from jaxtyping import Float64, UInt8

from lagsplat.array_types import Vector
from lagsplat.forces.operating_point import OperatingPoint
from lagsplat.splat.cpu.slice import FrameRasterizer
from lagsplat.splat.image_model import rasterize
from lagsplat.splat.projection import make_view, project
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.views.camera import Camera

RgbImage = UInt8[np.ndarray, "H W 3"]


class ImageRenderer:
    """Draws Gaussians in the image plane; ``stretch`` drawn pixels cover one of the training resolution."""

    def __init__(self, operating_point: OperatingPoint, side: int) -> None:
        autoencoder, self.chart = operating_point.autoencoder, operating_point.chart
        self.stretch, height, width = _fit_side(autoencoder, side)
        stretch = (width / autoencoder.width, height / autoencoder.height)
        self.rasterizer = FrameRasterizer(autoencoder.gaussians, height=height, width=width, stretch=stretch)

    def draw(self, q: Vector) -> RgbImage:
        """Draw a whitened state."""
        return self.rasterizer.draw(self.chart.to_raw(q[None])[0])

    def project_points(self, places: Float64[np.ndarray, "*B 2"]) -> Float64[np.ndarray, "*B 2"]:
        """Pixels of the drawn image at ``places`` on the matter [px of the training resolution]."""
        return self.stretch * places

    @property
    def center(self) -> tuple[float, float]:
        """The position at the centre of the image [px]."""
        return 0.5 * self.rasterizer.width / self.stretch, 0.5 * self.rasterizer.height / self.stretch


class SceneRenderer:
    """Draws Gaussians in space as the recording camera sees them, or another; else as `ImageRenderer`."""

    def __init__(self, operating_point: OperatingPoint, side: int) -> None:
        autoencoder, self.chart = operating_point.autoencoder, operating_point.chart
        assert autoencoder.lens is not None, "only Gaussians in space have a camera"
        self.model, self.backend = autoencoder.gaussians, autoencoder.backend
        self.stretch, height, width = _fit_side(autoencoder, side)
        (*focal, x, y), size = autoencoder.lens, (autoencoder.height, autoencoder.width)
        camera = Camera(np.eye(3), np.zeros(3), (focal[0], focal[1]), (x, y), *size)
        self.recording_camera = camera.resized(height, width)

    def draw(self, q: Vector) -> RgbImage:
        """Draw a whitened state from the recording camera."""
        return self.render_view(q, self.recording_camera)

    @torch.no_grad()
    def render_view(self, q: Vector, camera: Camera, *, color: torch.Tensor | None = None) -> RgbImage:
        """Draw what ``camera``, in the coordinates of the run, sees at a whitened state.

        A state or camera that overflows gives the background alone. ``color`` (K, 3) replaces the colours,
        over a black background.
        """
        raw = torch.from_numpy(self.chart.to_raw(q[None])).to(self.model.center)
        scene = self.model.condition(raw)
        if color is not None:
            scene = scene._replace(color=color.to(raw), background=torch.zeros_like(scene.background))
        height, width = camera.height, camera.width
        flat = project(scene, make_view([camera]), height=height, width=width)
        drawn = rasterize(*flat, height=height, width=width, backend=self.backend)
        return drawn[0].clamp(0.0, 1.0).mul(255.0).add(0.5).byte().permute(1, 2, 0).cpu().numpy()

    def project_points(self, places: Float64[np.ndarray, "*B 3"]) -> Float64[np.ndarray, "*B 2"]:
        """Pixels of the drawn image at ``places`` on the matter [px of the training resolution]."""
        return self.recording_camera.project(places.reshape(-1, 3)).reshape(*places.shape[:-1], 2)

    @property
    def center(self) -> tuple[float, float, float]:
        """The pivot [px at the pivot]."""
        return 0.0, 0.0, self.recording_camera.focal[0] / self.stretch


FrameRenderer = ImageRenderer | SceneRenderer


def open_renderer(operating_point: OperatingPoint, *, side: int) -> FrameRenderer:
    """Open the renderer for a run in the image plane or in space; ``side`` is the longer side [px]."""
    kind = ImageRenderer if operating_point.matter.space == 2 else SceneRenderer
    return kind(operating_point, side)


def _fit_side(autoencoder: Autoencoder, side: int) -> tuple[float, int, int]:
    """Factor, height and width of the image whose longer side is ``side``."""
    stretch = side / max(autoencoder.height, autoencoder.width)
    return stretch, max(1, round(stretch * autoencoder.height)), max(1, round(stretch * autoencoder.width))
