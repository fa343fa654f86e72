"""Registers film frames to the picture of a body: Gauss-Newton on the colours that its motion should keep.

A point of a body shows the colour that it has in the picture at the reference state, wherever the state
takes it. Displacements are finite: an infinitesimal one, the derivative of a picture by the state, is biased
by what a blurred picture cannot show.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from scipy.special import gammaincinv
from torch import Tensor

from lagsplat.array_types import Latents
from lagsplat.matter.blurred_film import BlurredFilm, Samples, sample_films
from lagsplat.matter.body_motion import BodyMotion, Points

TUNING = 3.787
"""Scale of Geman and McClure's loss in deviations, at which it is 95 % efficient for Gaussian noise."""
CHANNELS = 3
LOW = 0.25  # share of the texture of a patch, at least, that one body is taken to have
# that quantile of the length of a vector of normal numbers
SMALL = float(gammaincinv(CHANNELS / 2, LOW) * 2.0) ** 0.5
MOST_RESIDUALS = 100_000  # of which a scale is read
SCALES, STEPS = 4, 8  # rounds of a scale and of steps under it
SAME = 0.95  # of a scale, from which the next one is the same
LEAST_GAIN = 1e-3  # of a step, relative to the loss
FIRST_DAMPING, LEAST_DAMPING, TRIALS = 1e-3, 1e-9, 6  # of Levenberg and Marquardt
OUTSIDE = 0.5  # loss of a point outside the image, of which nothing is known, over the largest
CHUNK = 4_000_000  # numbers of a Jacobian at a time

Colors = Float[Tensor, "C P 3"]


@dataclass(frozen=True)
class Patch:
    """Points of the pictures of all cameras at the reference state.

    Args:
        points: their places [px].
        colors: what a picture shows there, blurred as a film is.
        texture: squared gradient of a picture there [1/px^2]: how much a point tells of its motion.
        away: distance of the colours from those of most frames in the same place: what stays where it is has
            none, and tells of no motion. Nor does what a picture does not show.
    """

    points: Points
    colors: Colors
    texture: Float[Tensor, "C P"]
    away: Float[Tensor, "C P"]


def register_body(
    films: Sequence[BlurredFilm],
    patch: Patch,
    motion: BodyMotion,
    q: Latents,
    *,
    noise: float,
) -> tuple[BodyMotion, float]:
    """Fit a motion to frames of a film, from one that is near.

    The scale of the loss follows the residuals, and so falls as the fit gets better.

    Args:
        films: one for each camera, with a frame for each state of ``q``.
        patch: points that may belong to the body.
        motion: the start.
        noise: standard deviation of a colour of the film, below which no residual is taken seriously.

    Returns:
        The motion, and the scale of the loss at its end [colour].

    Source: Lucas and Kanade, An Iterative Image Registration Technique, IJCAI 1981; the loss is of Geman and
    McClure, 1987.
    """
    scale = torch.inf
    for _ in range(SCALES):
        residuals = measure_residuals(films, patch, motion, q)
        before, scale = scale, estimate_scale(residuals, patch.texture, noise=noise)
        if scale > SAME * before:
            break
        motion = _descend(films, patch, motion, q, scale=scale)
    return motion, scale


def measure_residuals(
    films: Sequence[BlurredFilm],
    patch: Patch,
    motion: BodyMotion | None,
    q: Latents,
) -> Float[Tensor, "B C P"]:
    """Distance of the colours that points have in frames from those in the pictures; NaN outside the image.

    Without a motion the points stay where they are.
    """
    left = []
    for seen in _follow_points(films, patch, motion, q):
        left.append((seen.color - patch.colors).norm(dim=3).where(seen.inside, torch.nan))
    return torch.cat(left)


def average_colors(
    films: Sequence[BlurredFilm],
    patch: Patch,
    motion: BodyMotion | None,
    q: Latents,
    *,
    scale: float,
) -> Colors:
    """Colours that points have in frames on average, where outliers by those of the patch hardly count.

    Source: Learned-Miller, Data Driven Image Models through Continuous Joint Alignment, IEEE Transactions on
    Pattern Analysis and Machine Intelligence 28 (2006).
    """
    total, weights = torch.zeros_like(patch.colors), torch.zeros_like(patch.colors[..., :1])
    for seen in _follow_points(films, patch, motion, q):
        share = scale**2 / (scale**2 + (seen.color - patch.colors).square().sum(3))
        weight = share.square().where(seen.inside, 0.0)[..., None]
        total += (weight * seen.color).sum(0)
        weights += weight.sum(0)
    return torch.where(weights > 0.0, total / weights.clamp(min=1e-300), patch.colors)


def _follow_points(
    films: Sequence[BlurredFilm], patch: Patch, motion: BodyMotion | None, q: Latents
) -> Iterator[Samples]:
    """What points show in the frames at states, some frames at a time; without a motion they stay."""
    points = patch.points
    for part in cut_frames(len(q), patch.colors.numel() * CHANNELS):
        some = q[part]
        places = points.expand(len(some), -1, -1) if motion is None else motion.carry(points, some)
        yield sample_films(films, part, places)


def estimate_scale(residuals: Float[Tensor, "B C P"], weight: Float[Tensor, "C P"], *, noise: float) -> float:
    """Scale of the loss [colour] from the smaller residuals, where points count by a ``weight``.

    Points without texture keep their colour under any motion and should hardly count. The larger residuals
    may be of another body.
    """
    some = slice(None, None, max(1, residuals.numel() // MOST_RESIDUALS))
    values, order = residuals.flatten()[some].nan_to_num(torch.inf).sort()
    summed = weight.expand_as(residuals).flatten()[some][order].cumsum(0)
    at = int(torch.searchsorted(summed, LOW * summed[-1]))
    return TUNING * max(noise, float(values[min(at, len(values) - 1)]) / SMALL)


def cut_frames(count: int, numbers: int) -> list[slice]:
    """Parts of some frames that take `CHUNK` numbers, if each takes as many as ``numbers``."""
    step = max(1, CHUNK // max(1, numbers))
    return [slice(start, start + step) for start in range(0, count, step)]


def evaluate_loss(residuals: Float[Tensor, "*S"], *, scale: float) -> Float[Tensor, "*S"]:
    """Loss of each residual in [0, 1], ``r^2 / (s^2 + r^2)``; `OUTSIDE` where it is NaN."""
    square = residuals.square()
    return (square / (scale**2 + square)).nan_to_num(OUTSIDE)


def _descend(
    films: Sequence[BlurredFilm],
    patch: Patch,
    motion: BodyMotion,
    q: Latents,
    *,
    scale: float,
) -> BodyMotion:
    """Steps of Levenberg and Marquardt under one scale."""
    damping = FIRST_DAMPING
    loss, normal, slope = _linearize(films, patch, motion, q, scale=scale)
    for _ in range(STEPS):
        for _ in range(TRIALS):
            damped = normal + damping * torch.diag(normal.diagonal())
            step = -torch.linalg.solve(damped, slope).view_as(motion.coefficients)
            after = replace(motion, coefficients=motion.coefficients + step)
            trial = _linearize(films, patch, after, q, scale=scale)
            if trial[0] < loss:
                break
            damping *= 10.0
        else:
            return motion
        gain = 1.0 - trial[0] / loss
        motion, (loss, normal, slope) = after, trial
        damping = max(damping / 10.0, LEAST_DAMPING)
        if gain < LEAST_GAIN:
            break
    return motion


def _linearize(
    films: Sequence[BlurredFilm],
    patch: Patch,
    motion: BodyMotion,
    q: Latents,
    *,
    scale: float,
) -> tuple[float, Float[Tensor, "n n"], Float[Tensor, " n"]]:
    """The loss [colour^2], its second derivative after Gauss and Newton, and its gradient.

    A prior of one size per coefficient and deviation of the state holds what no frame tells. Points count by
    the loss that they would have if they stayed where they are.
    """
    moves = evaluate_loss(patch.away, scale=scale)
    k, p = motion.coefficients.shape
    normal = scale**2 * torch.eye(k * p, dtype=patch.points.dtype)
    slope = scale**2 * motion.coefficients.flatten()
    loss = scale**2 * float(motion.coefficients.square().sum())
    for part in cut_frames(len(q), patch.points.numel() * p):
        monomials, _ = motion.evaluate_latent_monomials(q[part])
        places, by_pose = motion.differentiate_by_pose(patch.points, q[part])
        seen = sample_films(films, part, places)
        residual = seen.color - patch.colors
        share = scale**2 / (scale**2 + residual.square().sum(3))
        loss += scale**2 * float((moves * (1.0 - share).where(seen.inside, OUTSIDE)).sum())
        weight = (moves * share.square()).where(seen.inside, 0.0)
        weighted = weight[..., None, None] * seen.gradient
        curvature = torch.einsum("bkpcx,bkpcy->bpxy", weighted, seen.gradient)
        pull = torch.einsum("bkpcx,bkpc,bpxi->bi", weighted, residual, by_pose)
        own = by_pose.flatten(1, 2).mT @ (curvature @ by_pose).flatten(1, 2)
        normal += torch.einsum("ba,bc,bij->aicj", monomials, monomials, own).reshape(k * p, k * p)
        slope = slope + (monomials.mT @ pull).flatten()
    return loss, normal, slope
