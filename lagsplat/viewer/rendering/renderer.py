"""Pictures of a session, at a size of one's own choice: as the film's camera sees it, or any other."""

from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float64, UInt8

from lagsplat.chart.chart import Chart
from lagsplat.splat.backend import choose_rasterizer
from lagsplat.splat.cpu.slice import FrameRasterizer
from lagsplat.splat.projection import make_view, project
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.views.camera import Camera

Picture = UInt8[np.ndarray, "H W 3"]


@runtime_checkable
class FrameRenderer(Protocol):
    """Draws whitened states as the film's camera sees them; ``stretch`` pixels of its pictures make one of
    the training resolution.
    """

    stretch: float

    def draw(self, q: Float64[np.ndarray, " d"]) -> Picture:
        """The picture at a state."""

    def pixels(self, places: Float64[np.ndarray, "*B n"]) -> Float64[np.ndarray, "*B 2"]:
        """Where places on the matter are in the drawn picture."""

    @property
    def middle(self) -> tuple[float, ...]:
        """The place in the middle of the picture; in space at the pivot."""


class ImageRenderer:
    """An `FrameRenderer` for Gaussians that live in the picture."""

    def __init__(self, autoencoder: Autoencoder, chart: Chart, *, side: int) -> None:
        self.chart = chart
        self.stretch, height, width = _sized(autoencoder, side)
        stretch = (width / autoencoder.width, height / autoencoder.height)
        self.drawer = FrameRasterizer(autoencoder.gaussians, height=height, width=width, stretch=stretch)

    def draw(self, q: Float64[np.ndarray, " d"]) -> Picture:
        """The picture at a state."""
        return self.drawer.draw(self.chart.to_raw(q[None])[0])

    def pixels(self, places: Float64[np.ndarray, "*B 2"]) -> Float64[np.ndarray, "*B 2"]:
        """Where places on the matter are in the drawn picture."""
        return self.stretch * places

    @property
    def middle(self) -> tuple[float, float]:
        """The place in the middle of the picture."""
        return 0.5 * self.drawer.width / self.stretch, 0.5 * self.drawer.height / self.stretch


class SceneRenderer:
    """An `FrameRenderer` for Gaussians that live in space, which other cameras may see, too."""

    def __init__(self, autoencoder: Autoencoder, chart: Chart, *, side: int) -> None:
        assert autoencoder.lens is not None, "only Gaussians of space are seen by cameras"
        self.model, self.chart = autoencoder.gaussians, chart
        self.rasterize = choose_rasterizer(autoencoder.backend, self.model.center.device)
        self.stretch, height, width = _sized(autoencoder, side)
        across, down, x, y = autoencoder.lens
        size = {"height": autoencoder.height, "width": autoencoder.width}
        filmed = Camera(np.eye(3), np.zeros(3), (across, down), (x, y), **size)
        self.filmed = filmed.resized(height, width)

    def draw(self, q: Float64[np.ndarray, " d"]) -> Picture:
        """The picture at a state, from where the film was taken."""
        return self.seen(q, self.filmed)

    @torch.no_grad()
    def seen(
        self, q: Float64[np.ndarray, " d"], camera: Camera, *, color: torch.Tensor | None = None
    ) -> Picture:
        """What a camera of the run's coordinates sees, in its own pixels; a state or a camera beyond the
        numbers shows the background alone. ``color`` (K, 3) may stand in place of the colours, over black.
        """
        raw = torch.from_numpy(self.chart.to_raw(q[None])).to(self.model.center)
        scene = self.model.condition(raw)
        if color is not None:
            scene = scene._replace(color=color.to(raw), background=torch.zeros_like(scene.background))
        size = {"height": camera.height, "width": camera.width}
        drawn = self.rasterize(*project(scene, make_view([camera]), **size), **size)
        return drawn[0].clamp(0.0, 1.0).mul(255.0).add(0.5).byte().permute(1, 2, 0).cpu().numpy()

    def pixels(self, places: Float64[np.ndarray, "*B 3"]) -> Float64[np.ndarray, "*B 2"]:
        """Where places on the matter are in the drawn picture."""
        return self.filmed.project(places.reshape(-1, 3)).reshape(*places.shape[:-1], 2)

    @property
    def middle(self) -> tuple[float, float, float]:
        """The pivot."""
        return 0.0, 0.0, self.filmed.focal[0] / self.stretch


def open_renderer(autoencoder: Autoencoder, chart: Chart, *, side: int) -> ImageRenderer | SceneRenderer:
    """The easel that suits where the Gaussians live; ``side`` is the longer side of its pictures [px]."""
    kind = ImageRenderer if autoencoder.gaussians.space == 2 else SceneRenderer
    return kind(autoencoder, chart, side=side)


def _sized(autoencoder: Autoencoder, side: int) -> tuple[float, int, int]:
    stretch = side / max(autoencoder.height, autoencoder.width)
    height, width = (max(1, round(stretch * n)) for n in (autoencoder.height, autoencoder.width))
    return stretch, height, width
