"""The frames that are registered, sharp and blurred, of one camera or several, and motions fitted to them.

Frames near the mean state come first, blurred, and then the others and sharper ones.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import torch
from jaxtyping import Bool, Float64, Int
from scipy.special import gammaincinv
from torch import Tensor

from lagsplat.array_types import Series
from lagsplat.matter.blurred_film import (
    MOSTLY,
    BlurredFilm,
    CameraFilm,
    Samples,
    blur_frames,
    sample_films,
)
from lagsplat.matter.body_motion import BodyMotion, Points, make_body_at_rest
from lagsplat.matter.occlusion import DepthBuffer
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
PARTS = 3  # of a film, to which a motion is fitted again
WITHHELD = 5  # one frame in so many
FEWEST = 12  # pixels of a body
MOST_POINTS = 2000  # of a body that are registered
# deviations of a colour's noise that a pixel which stays as it is keeps to: a quantile of a vector's length
STAYS = float(2.0 * gammaincinv(3 / 2, 0.99)) ** 0.5
LAST = -1  # level of the sharpest film
LEAST_WEIGHT = 1e-12  # of a camera in the mean over cameras, so that there is one


class FilmLevel:
    """The film of a camera, and its picture at the mean state, at one blur [px].

    ``away`` is the median distance of the picture's colours from those of the frames. The images of ``maps``
    are the picture, its derivative by each latent, and ``away`` in place of all three colours. Gradients of
    frames are found as these are needed: they would take twice the memory of the colours.
    """

    def __init__(self, source: CameraFilm, q: Series, near: Int[np.ndarray, " k"], *, blur_px: float) -> None:
        colors, share = blur_frames(source, blur_px=blur_px)
        picture = fit_rest_picture(colors[near], q[near])
        distance = np.linalg.norm(colors - picture.color, axis=3)
        if share is not None:
            distance *= share > MOSTLY
        self.noise, self.away = picture.noise, np.median(distance, axis=0)
        apart = self.away[..., None].repeat(3, axis=2)
        maps = torch.from_numpy(np.stack([picture.color, *picture.slope, apart])).float().movedim(3, 1)
        self.colors, self.camera = torch.from_numpy(colors).movedim(3, 1).contiguous(), source.camera
        self.share = None if share is None else torch.from_numpy(share)[:, None]
        known = None if self.share is None else self.share[near].amin(0).expand(len(maps), -1, -1, -1)
        self.maps = BlurredFilm(maps, source.camera, known)

    def select(self, frames: Int[Tensor, " B"]) -> BlurredFilm:
        """The film of some of the frames."""
        share = None if self.share is None else self.share[frames]
        return BlurredFilm(self.colors[frames], self.camera, share)


@dataclass(frozen=True)
class FittedBody:
    """A motion, the scale of its loss [colour], and the mean loss for each degree of bending tried."""

    motion: BodyMotion
    scale: float
    losses: tuple[float, ...] = ()


class FilmRegistration:
    """Films to whose frames motions are fitted.

    Args:
        films: of one camera or several, some frames near the mean state, and others at random. The first
            camera is that of the recording, on whose pixels bodies are found.
        points: what each pixel of the recording shows at the mean state, row by row [px]; NaN if unknown.
        q: states of the frames [whitened units].
        near: numbers of those near the mean state.
        latent_degree: of the polynomials of the state that poses are.

    Raises:
        ValueError: nothing moves near the mean state, or too few frames are near it.
    """

    def __init__(
        self,
        films: Sequence[CameraFilm],
        points: Points,
        q: Series,
        near: Int[np.ndarray, " k"],
        latent_degree: int,
    ) -> None:
        self.q, self.latent_degree = torch.from_numpy(q), latent_degree
        self.ball = enclose_states(self.q)
        self.height, self.width = films[0].frames.shape[1:3]
        self.distance = np.linalg.norm(q, axis=1)
        self.known = points.isfinite().all(1).view(self.height, self.width).numpy()
        self.points = points.nan_to_num(nan=0.0)  # which no camera shows
        self.buffers = [DepthBuffer(points, film.camera) for film in films[1:] if film.camera]
        sharp = FilmLevel(films[0], q, near, blur_px=SHARPEST_PX)
        self.noise = sharp.noise
        self.moving = self.known & (sharp.away > STAYS * self.noise)
        if self.moving.sum() < FEWEST:
            deep = "" if self.known.all() else " and have a depth"
            raise ValueError(
                f"only {int(self.moving.sum())} pixels change their colour in most frames{deep}: there is no "
                "matter to register. Look at reconstruction.png: does anything move?"
            )
        moving = torch.from_numpy(self.moving.ravel())
        self.size = measure_size(self.points[moving])
        coarsest = COARSEST * measure_size(list_pixels(self.height, self.width)[moving])
        blurs = [max(SHARPEST_PX, coarsest / 2**i) for i in range(1 + max(leg[1] for leg in LEGS))]
        self.levels = [[FilmLevel(each, q, near, blur_px=blur_px) for each in films] for blur_px in blurs]
        everything = np.arange(len(q))
        rank = np.argsort(np.argsort(self.distance, kind="stable"), kind="stable")
        self.withheld = everything[rank % WITHHELD == WITHHELD - 1]
        self.kept = everything[rank % WITHHELD != WITHHELD - 1]

    def choose_points(self, region: Bool[np.ndarray, "H W"]) -> Points:
        """Pixels of a region, `MOST_POINTS` of them at most."""
        return thin_points(self.points[torch.from_numpy(np.flatnonzero(region.ravel()))])

    def fit_motion(self, points: Points, bending: int) -> FittedBody:
        """Fit a motion leg by leg, and then to the pictures that the registered frames show on average.

        First the recording's camera goes alone: it tells of motion across it even if depths are wrong.
        """
        motion = self._start(make_body_at_rest(points, self.ball, bending=bending), points)
        scale = self.noise
        for cameras, (share, level, degree) in product(sorted({1, len(self.levels[LAST])}), LEGS):
            near = self.distance <= np.quantile(self.distance, share)
            motion, scale = self._register(
                motion.with_latent_degree(min(degree, self.latent_degree)),
                self._read_patch(points, level, cameras),
                level,
                self.kept[near[self.kept]],
            )
        for _ in range(AVERAGES):
            motion, scale = self._register(motion, self._average(motion, points, scale), LAST, self.kept)
        return FittedBody(motion, scale)

    def measure_deviations(self, body: FittedBody, points: Points) -> FittedBody:
        """Fit a motion again to parts of the film, which tell how well it is known; of few points, none does.

        Parts are contiguous, so that errors which last for some frames do not average out within one. What
        all frames have in common, such as an error of the states, shows in no part.

        Source: the batch-means estimate of a variance, with `PARTS` batches.
        """
        if len(points) < FEWEST:
            return body
        patch = self._average(body.motion, points, body.scale)
        batches = [part for part in np.array_split(self.kept, PARTS) if len(part)]
        parts = [self._register(body.motion, patch, LAST, part)[0].coefficients for part in batches]
        mean, share = torch.stack(parts).mean(0), (len(parts) * (len(parts) - 1)) ** 0.5
        deviations = tuple((part - mean) / share for part in parts)
        return replace(body, motion=replace(body.motion, deviations=deviations))

    def weigh(self, points: Points, *, scale: float) -> Float64[np.ndarray, " P"]:
        """Weights of points, of sum one: the losses that they would have if they stayed where they are."""
        losses = evaluate_loss(self._read_patch(points, LAST).away, scale=scale).mean(0).numpy()
        return losses / losses.sum()

    def _start(self, still: BodyMotion, points: Points) -> BodyMotion:
        """The motion that explains the derivative of the blurred picture by the state, outliers but little.

        It is too small, but away from the still background, which the uncovered pixels of a region keep.
        """
        seen = self._read_maps(points, 0, 1)
        change = seen.color[1:-1, 0].movedim(0, 2)
        at_rest = torch.zeros(1, still.d, dtype=torch.float64)
        design = seen.gradient[0, 0] @ still.differentiate_by_pose(points, at_rest)[1][0]
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

        They are means over cameras, which count by the loss that the point would have if it stayed: from some
        sides it is hidden. Without a motion the points stay where they are.
        """
        frames, patch = torch.from_numpy(chosen), self._average(motion, points, scale)
        left = measure_residuals(self._select(LAST, frames), patch, motion, self.q[frames])
        weight = evaluate_loss(patch.away, scale=scale) + LEAST_WEIGHT
        return ((evaluate_loss(left, scale=scale) * weight).sum(1) / weight.sum(0)).numpy()

    def _register(
        self, motion: BodyMotion, patch: Patch, level: int, chosen: Int[np.ndarray, " B"]
    ) -> tuple[BodyMotion, float]:
        frames = torch.from_numpy(chosen)
        films = self._select(level, frames, len(patch.colors))
        return register_body(films, patch, motion, self.q[frames], noise=self.noise)

    def _average(self, motion: BodyMotion | None, points: Points, scale: float) -> Patch:
        """Points with the colours that they have on average in the registered frames."""
        frames, patch = torch.from_numpy(self.kept), self._read_patch(points, LAST)
        colors = average_colors(self._select(LAST, frames), patch, motion, self.q[frames], scale=scale)
        return replace(patch, colors=colors)

    def _select(self, level: int, frames: Int[Tensor, " B"], cameras: int | None = None) -> list[BlurredFilm]:
        return [each.select(frames) for each in self.levels[level][:cameras]]

    def _read_patch(self, points: Points, level: int, cameras: int | None = None) -> Patch:
        """Points of the pictures at the mean state of some first cameras, or of all."""
        seen = self._read_maps(points, level, cameras)
        inside, gradient = seen.inside[0], seen.gradient[0]
        texture, away = gradient.square().sum((2, 3)), seen.color[-1, ..., 0].clamp(min=0.0)
        return Patch(points, seen.color[0], texture.where(inside, 0.0), away.where(inside, 0.0))

    def _read_maps(self, points: Points, level: int, cameras: int | None) -> Samples:
        """Read the maps of each camera where it sees points; inside is what nothing hides from it."""
        maps = [each.maps for each in self.levels[level][:cameras]]
        seen = sample_films(maps, slice(None), points.expand(2 + self.q.shape[1], -1, -1))
        for number, buffer in enumerate(self.buffers[: len(maps) - 1], start=1):
            seen.inside[:, number] &= buffer.shows(points)
        return seen


def thin_points(points: Points) -> Points:
    """`MOST_POINTS` of some points, evenly by number, or all."""
    if len(points) <= MOST_POINTS:
        return points
    return points[torch.linspace(0, len(points) - 1, MOST_POINTS).long()]


def list_pixels(height: int, width: int) -> Points:
    """Centres of the pixels of an image, row by row [px]."""
    rows, columns = torch.arange(height).double() + 0.5, torch.arange(width).double() + 0.5
    return torch.cartesian_prod(rows, columns).flip(1)


def measure_size(points: Points) -> float:
    """Root mean square distance of points from their mean [px]."""
    return float((points - points.mean(0)).square().sum(1).mean().sqrt())
