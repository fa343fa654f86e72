"""The frames of a film that are registered, sharp and blurred, and motions that are fitted to them.

Frames near the mean state come first, blurred, and then the others and sharper ones.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float64, Int
from scipy.stats import chi

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
from lagsplat.matter.rest_picture import fit_rest_picture
from lagsplat.monomials import enclose_states

LEGS = ((0.15, 0, 1), (0.3, 0, 1), (0.3, 1, 1), (0.5, 1, 2), (1.0, 1, 3), (1.0, 2, 3))
"""Share of the frames nearest to the mean state, level of blur, and highest degree of poses in the state."""
COARSEST = 0.1  # blur of the first level, as a share of the size of what moves; each level halves it
SHARPEST_PX = 0.25
STARTS, RIDGE = 6, 1e-3  # rounds of reweighting of the linear start, and its ridge, relative
AVERAGES = 2  # rounds in which the picture becomes the average over the registered frames
WITHHELD = 5  # one frame in so many
FEWEST = 12  # pixels of a body
MOST_POINTS = 2000  # of a body that are registered
STAYS = float(chi(3).ppf(0.99))  # deviations of a colour's noise that a pixel which stays as it is keeps to
LAST = -1  # level of the sharpest film


class FilmLevel:
    """A film and its picture at the mean state at one blur [px].

    ``slopes`` are the derivatives of the picture down and across [1/px], ``texture`` its squared gradient
    [1/px^2], ``away`` the median distance of its colours from those of the frames.
    """

    def __init__(self, frames: Frames, q: Series, near: Int[np.ndarray, " k"], *, blur_px: float) -> None:
        self.film = BlurredFilm(frames, blur_px=blur_px)
        self.picture = fit_rest_picture(frames[near], q[near], blur_px=blur_px)
        color = self.picture.color
        self.slopes = np.gradient(color, axis=(0, 1))
        self.texture = np.square(self.slopes).sum((0, 3))
        colors = self.film.channels[:, :3].movedim(1, 3).numpy()
        self.away = np.median(np.linalg.norm(colors - color, axis=3), axis=0)


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
        sharp = FilmLevel(frames, q, near, blur_px=SHARPEST_PX)
        self.noise = sharp.picture.noise
        self.moving = sharp.away > STAYS * self.noise
        if self.moving.sum() < FEWEST:
            raise ValueError(
                f"only {int(self.moving.sum())} pixels change their colour in most frames: there is no "
                "matter to register. Look at reconstruction.png: does anything move?"
            )
        places = self.pixels[torch.from_numpy(self.moving.ravel())]
        self.size = float((places - places.mean(0)).square().sum(1).mean().sqrt())
        blurs = [
            max(SHARPEST_PX, COARSEST * self.size / 2**i) for i in range(1 + max(leg[1] for leg in LEGS))
        ]
        self.levels = [FilmLevel(frames, q, near, blur_px=blur_px) for blur_px in blurs]
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
        motion = self._start(make_body_at_rest(points, self.ball, bending=bending), points)
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

    def weigh(self, points: Points, *, scale: float) -> Float64[np.ndarray, " P"]:
        """Weights of points, of sum one: the losses that they would have if they stayed where they are."""
        losses = evaluate_loss(self._read_patch(points, LAST).away, scale=scale).numpy()
        return losses / losses.sum()

    def _start(self, still: BodyMotion, points: Points) -> BodyMotion:
        """The motion that explains the derivative of the blurred picture by the state, outliers but little.

        It is too small, but away from the still background, which the uncovered pixels of a region keep.
        """
        column, row = points.long().unbind(1)
        first = self.levels[0]
        down, across = (torch.from_numpy(each)[row, column] for each in first.slopes)
        change = torch.from_numpy(first.picture.slope).movedim(0, 3)[row, column]
        at_rest = torch.zeros(1, still.d, dtype=torch.float64)
        by_pose = still.differentiate_by_pose(points, at_rest)[1][0]
        design = torch.stack([across, down], 2) @ by_pose
        coefficients = still.coefficients
        for _ in range(STARTS):
            left = change + design @ coefficients.T
            size = left.square().sum((1, 2))
            weight = (size.median() / (size.median() + size).clamp(min=1e-300)).square()
            weighted = (weight[:, None, None] * design).flatten(0, 1)
            normal = weighted.T @ design.flatten(0, 1)
            normal += RIDGE * torch.diag(normal.diagonal()) + 1e-12 * torch.eye(
                len(normal), dtype=normal.dtype
            )
            coefficients = -torch.linalg.solve(normal, weighted.T @ change.flatten(0, 1)).T
        return replace(still, coefficients=coefficients)

    def measure_losses(
        self, motion: BodyMotion | None, points: Points, *, scale: float, chosen: Int[np.ndarray, " B"]
    ) -> Float64[np.ndarray, "B P"]:
        """Losses of points in some frames, against their average colours in those that were registered.

        Without a motion the points stay where they are.
        """
        frames, patch = torch.from_numpy(chosen), self._average(motion, points, scale)
        film = self.levels[LAST].film.select(frames)
        left = measure_residuals(film, patch, motion, self.q[frames])
        return evaluate_loss(left, scale=scale).numpy()

    def _register(
        self, motion: BodyMotion, patch: Patch, level: int, chosen: Int[np.ndarray, " B"]
    ) -> tuple[BodyMotion, float]:
        frames = torch.from_numpy(chosen)
        film = self.levels[level].film.select(frames)
        return register_body(film, patch, motion, self.q[frames], noise=self.noise)

    def _average(self, motion: BodyMotion | None, points: Points, scale: float) -> Patch:
        """Points with the colours that they have on average in the registered frames."""
        frames, patch = torch.from_numpy(self.kept), self._read_patch(points, LAST)
        film = self.levels[LAST].film.select(frames)
        colors = average_colors(film, patch, motion, self.q[frames], scale=scale)
        return replace(patch, colors=colors)

    def _read_patch(self, points: Points, level: int) -> Patch:
        """Pixels of the picture at the mean state."""
        column, row = points.long().unbind(1)
        at = self.levels[level]
        maps = (at.picture.color, at.texture, at.away)
        return Patch(points, *(torch.from_numpy(each)[row, column].double() for each in maps))
