"""What is known of space where a film's matter is found there: depth, the camera, and views from others."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.array_types import Frames
from lagsplat.chart.chart import Chart
from lagsplat.matter.blurred_film import CameraFilm
from lagsplat.matter.body_motion import Points
from lagsplat.matter.depth import draw_depth
from lagsplat.matter.film_registration import list_pixels
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.views.camera import Camera
from lagsplat.views.novel import NovelViews, require_views

MOST_VIEWS = 4  # cameras besides the recording's; with six the simulated rocker's error is the same


@dataclass(frozen=True)
class MatterScene:
    """The space in front of the recording's camera, in its axes from its centre [px at the pivot].

    Args:
        depth: of what each pixel shows at the mean state; NaN if unknown.
        lens: focal lengths and principal point (x, y, x, y) of the recording's camera [px].
        views: of the frames that are registered, from other cameras. Without them only perspective tells of
            motion along the line of sight.
    """

    depth: Float64[np.ndarray, "H W"]
    lens: tuple[float, float, float, float]
    views: NovelViews | None = None

    @property
    def camera(self) -> Camera:
        """The recording's camera."""
        across, down, x, y = self.lens
        return Camera(np.eye(3), np.zeros(3), (across, down), (x, y), *self.depth.shape)

    def lift_pixels(self) -> Points:
        """The point that each pixel of the recording shows at the mean state, row by row; NaN if unknown."""
        pixels = list_pixels(*self.depth.shape)
        focal, middle = (pixels.new_tensor(each) for each in (self.lens[:2], self.lens[2:]))
        ahead = torch.cat([(pixels - middle) / focal, torch.ones_like(pixels[:, :1])], 1)
        return torch.from_numpy(self.depth).reshape(-1, 1) * ahead

    def collect_films(self, frames: Frames, chosen: np.ndarray) -> list[CameraFilm]:
        """Films of some of the frames: that of the recording's camera, and those of the chosen views.

        Raises:
            ValueError: the depth is of another size than the frames, or views are of other instants.
        """
        if self.depth.shape != frames.shape[1:3]:
            raise ValueError(f"a depth of {self.depth.shape} pixels for frames of {frames.shape[1:3]}")
        films = [CameraFilm(np.asarray(frames[chosen]), self.camera)]
        if self.views is None:
            return films
        require_views(self.views, frames)
        for number in choose_views(self.views):
            images, cover = self.views.images[chosen, number], self.views.cover
            known = None if cover is None else cover[chosen, number]
            films.append(CameraFilm(images, self.views.space.seen_by(self.views.cameras[number]), known))
        return films


def make_scene(autoencoder: Autoencoder, chart: Chart, views: NovelViews | None) -> MatterScene | None:
    """The scene of a run; None if its Gaussians live in the picture.

    Args:
        autoencoder: of the run, whose depth at the mean state is drawn.
        chart: of the run.
        views: of all its frames; those of training frames are taken.
    """
    if autoencoder.lens is None:
        return None
    depth = draw_depth(autoencoder, chart.to_raw(np.zeros((1, chart.d)))[0])
    across, down, x, y = autoencoder.lens
    return MatterScene(depth, (across, down, x, y), None if views is None else views.first(chart.n_train))


def choose_views(views: NovelViews) -> list[int]:
    """Cameras that training sees, `MOST_VIEWS` at most, each as far from the others as can be."""
    seen = [views.space.seen_by(views.cameras[number]).position for number in views.seen]
    away = np.linalg.norm(seen, axis=1)  # from the recording's camera
    chosen: list[int] = []
    while len(chosen) < min(MOST_VIEWS, len(seen)):
        farthest = int(away.argmax())
        chosen.append(views.seen[farthest])
        away = np.minimum(away, np.linalg.norm(np.subtract(seen, seen[farthest]), axis=1))
    return chosen
