"""The frames of a film that are registered, sharp and blurred, and motions that are fitted to them.

Frames near the mean state come first, blurred, and then the others and sharper ones.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float64, Int

from lagsplat.array_types import Frames, Series
from lagsplat.matter.blurred_film import BlurredFilm
from lagsplat.matter.body_motion import BodyMotion, Points, make_body_at_rest
from lagsplat.matter.registration import (
    Patch,
    average_colors,
    evaluate_loss,
    measure_residuals,
    register_body,
)
from lagsplat.matter.rest_picture import RestPicture, fit_rest_picture
from lagsplat.monomials import enclose_states

LEGS = ((0.15, 0, 1), (0.3, 0, 1), (0.3, 1, 1), (0.5, 1, 2), (1.0, 1, 3), (1.0, 2, 3))
"""Share of the frames nearest to the mean state, level of blur, and highest degree of poses in the state."""
COARSEST = 0.1  # blur of the first level, as a share of the size of what moves; each level halves it
SHARPEST_PX = 0.25
AVERAGES = 2  # rounds in which the picture becomes the average over the registered frames
WITHHELD = 5  # one frame in so many
FEWEST = 12  # pixels of a body
MOST_POINTS = 2000  # of a body that are registered
LAST = -1  # level of the sharpest film


@dataclass(frozen=True)
class FilmLevel:
    """A film and its picture at the mean state at one blur."""

    film: BlurredFilm
    picture: RestPicture


@dataclass(frozen=True)
class FittedBody:
    """A motion, the scale of its loss [colour], and the mean loss for each degree of bending tried."""

    motion: BodyMotion
    scale: float
    losses: tuple[float, ...] = ()


class FilmRegistration:
    """A film to whose frames motions are fitted.

    Args:
        frames: of the film, some near the mean state, and others at random.
        q: their states [whitened units].
        near: numbers of those near the mean state.
        latent_degree: of the polynomials of the state that poses are.

    Raises:
        ValueError: nothing moves near the mean state, or too few frames are near it.
    """

    def __init__(self, frames: Frames, q: Series, near: Int[np.ndarray, " k"], latent_degree: int) -> None:
        self.q, self.latent_degree = torch.from_numpy(q), latent_degree
        self.ball = enclose_states(self.q)
        self.height, self.width = frames.shape[1:3]
        self.distance = np.linalg.norm(q, axis=1)
        columns, rows = np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5)
        self.pixels = torch.from_numpy(np.stack([columns.ravel(), rows.ravel()], axis=1))
        first = fit_rest_picture(frames[near], q[near], blur_px=SHARPEST_PX)
        self.moving, self.noise = first.moving, first.noise
        if self.moving.sum() < FEWEST:
            raise ValueError(
                f"only {int(self.moving.sum())} pixels change with the state near its mean: there is no "
                "matter to register. Look at reconstruction.png: does anything move?"
            )
        places = self.pixels[torch.from_numpy(self.moving.ravel())]
        self.size = float((places - places.mean(0)).square().sum(1).mean().sqrt())
        self.levels = []
        for level in range(1 + max(blur for _, blur, _ in LEGS)):
            blur_px = max(SHARPEST_PX, COARSEST * self.size / 2**level)
            film = BlurredFilm(frames, blur_px=blur_px)
            self.levels.append(FilmLevel(film, fit_rest_picture(frames[near], q[near], blur_px=blur_px)))
        everything = np.arange(len(q))
        rank = np.argsort(np.argsort(self.distance, kind="stable"), kind="stable")
        self.withheld = everything[rank % WITHHELD == WITHHELD - 1]
        self.kept = everything[rank % WITHHELD != WITHHELD - 1]

    def choose_points(self, region: Bool[np.ndarray, "H W"]) -> Points:
        """Pixels of a region, `MOST_POINTS` of them at most."""
        at = np.flatnonzero(region.ravel())
        if len(at) > MOST_POINTS:
            at = at[np.linspace(0, len(at) - 1, MOST_POINTS).astype(int)]
        return self.pixels[torch.from_numpy(at)]

    def fit_motion(self, points: Points, bending: int) -> FittedBody:
        """Fit a motion leg by leg, and then to the picture that the registered frames show on average."""
        motion = make_body_at_rest(points, self.ball, bending=bending)
        scale = self.noise
        for share, level, degree in LEGS:
            near = self.distance <= np.quantile(self.distance, share)
            motion, scale = self._register(
                motion.with_latent_degree(min(degree, self.latent_degree)),
                self._read_patch(points, level),
                level,
                self.kept[near[self.kept]],
            )
        for _ in range(AVERAGES):
            motion, scale = self._register(motion, self._average(motion, points, scale), LAST, self.kept)
        return FittedBody(motion, scale)

    def measure_losses(
        self, motion: BodyMotion | None, points: Points, *, scale: float, chosen: Int[np.ndarray, " B"]
    ) -> Float64[np.ndarray, "B P"]:
        """Losses of points in some frames, against their average colours in those that were registered.

        Without a motion the points stay where they are.
        """
        frames, film = torch.from_numpy(chosen), self.levels[LAST].film
        patch = self._average(motion, points, scale)
        left = measure_residuals(film, patch, motion, self.q[frames], frames)
        return evaluate_loss(left, scale=scale).numpy()

    def _register(
        self, motion: BodyMotion, patch: Patch, level: int, chosen: Int[np.ndarray, " B"]
    ) -> tuple[BodyMotion, float]:
        frames, film = torch.from_numpy(chosen), self.levels[level].film
        return register_body(film, patch, motion, self.q[frames], frames, noise=self.noise)

    def _average(self, motion: BodyMotion | None, points: Points, scale: float) -> Patch:
        """Points with the colours that they have on average in the registered frames."""
        frames, film = torch.from_numpy(self.kept), self.levels[LAST].film
        patch = self._read_patch(points, LAST)
        colors = average_colors(film, patch, motion, self.q[frames], frames, scale=scale)
        return replace(patch, colors=colors)

    def _read_patch(self, points: Points, level: int) -> Patch:
        """Pixels of the picture at the mean state."""
        column, row = points.long().unbind(1)
        color = self.levels[level].picture.color
        texture = np.square(np.gradient(color, axis=(0, 1))).sum((0, 3))
        return Patch(points, *(torch.from_numpy(each)[row, column] for each in (color, texture)))
