"""Finds the bodies of a film and how each moves with the state, in the image plane or in space.

A body moves as simply as withheld frames allow: rigidly, or by a smooth field of a degree as low as can be.
What moves is one body unless several explain withheld frames better.
"""

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Bool, Float64, Int
from scipy.ndimage import binary_fill_holes, gaussian_filter

from lagsplat.array_types import Frames, Series
from lagsplat.matter.blurred_film import CameraFilm
from lagsplat.matter.body_motion import BodyMotion, Points
from lagsplat.matter.config import MatterConfig
from lagsplat.matter.field import LEAST_EXPLAINED, BodyReport, MatterField, MatterReport
from lagsplat.matter.film_registration import FEWEST, FilmRegistration, FittedBody, list_pixels, thin_points
from lagsplat.matter.rest_picture import find_nearest_frames
from lagsplat.matter.scene import MatterScene

LABEL_BLUR_PX = 1.2  # over which pixels decide together to which body they belong
CLEARLY = 0.1  # loss that a body saves at a pixel that belongs to it, over the largest; set by hand
UNEXPLAINED = 0.5  # loss from which a residual is larger than its scale
WINDOWS = 6  # parts of a region, whose motions are tried on all of it
WINDOW = 0.5  # radius of a part, as a share of the size of what moves

Region = Bool[np.ndarray, "H W"]


def fit_matter(
    frames: Frames, q: Series, config: MatterConfig, *, seed: int = 0, scene: MatterScene | None = None
) -> tuple[MatterField, MatterReport]:
    """Find the bodies of a film, and how they move with the state.

    Args:
        frames: for training, filmed by a camera that stands still.
        q: their states as encoded [whitened units].
        config: settings.
        seed: of the choice of frames.
        scene: what else is known of space, whose matter is then found; None finds that of the image plane.

    Raises:
        ValueError: nothing moves near the mean state, no body keeps its colours, the film is too short, or
            the scene is of another one.
    """
    started_s, rng = time.perf_counter(), np.random.default_rng(seed)
    near = find_nearest_frames(q)
    chosen = np.unique(np.concatenate([near, rng.choice(len(q), min(len(q), config.frames), replace=False)]))
    degree = config.latent_degree or (3 if q.shape[1] == 1 else 2)
    of_near = np.flatnonzero(np.isin(chosen, near))
    if scene is None:
        films, points = [CameraFilm(np.asarray(frames[chosen]))], list_pixels(*frames.shape[1:3])
    else:
        films, points = scene.collect_films(frames, chosen), scene.lift_pixels()
    film = FilmRegistration(films, points, q[chosen], of_near, degree)
    bodies = choose_bodies(film, config)
    owned = list_points(film, bodies)
    bodies = [
        film.measure_deviations(each, thin_points(own)) for each, own in zip(bodies, owned, strict=True)
    ]
    matter = MatterField(
        tuple(each.motion for each in bodies),
        torch.cat(owned),
        torch.cat([torch.full((len(points),), i) for i, points in enumerate(owned)]),
    )
    report = MatterReport(
        bodies=report_bodies(film, bodies, owned),
        moving=int(film.moving.sum()),
        unexplained=int(find_unexplained(film, bodies).sum()),
        frames=len(chosen),
        noise=film.noise,
        wall_s=time.perf_counter() - started_s,
    )
    return matter, report


def choose_bodies(film: FilmRegistration, config: MatterConfig) -> list[FittedBody]:
    """The simplest bodies that explain withheld frames of what moves as well as the best ones do.

    Tried are one body of every degree of bending at which it does not fold, and several, of which each bends
    as little as it can. Simpler is what has fewer parameters of a pose; as well is within one standard error
    of the mean over frames.

    Raises:
        ValueError: hardly a pixel belongs to any.

    Source: Hastie, Tibshirani and Friedman, The Elements of Statistical Learning, section 7.10.
    """
    tried = [[each] for each in fit_degrees(film, film.moving, config.bending)[0]]
    regions = split_region(film, film.moving, config.bodies) if config.bodies > 1 else []
    if len(regions) > 1:
        parts = choose_parts(film, regions, config.bending)
        tried += [parts] if len(parts) > 1 else []
    tried.sort(key=lambda bodies: sum(each.motion.n_pose for each in bodies))
    scale = min(each.scale for bodies in tried for each in bodies)
    losses = [measure_least_losses(film, bodies, scale=scale) for bodies in tried]
    while tried:
        chosen = find_simplest(losses)
        if all(len(points) >= FEWEST for points in list_points(film, tried[chosen])):
            return tried[chosen]
        del tried[chosen], losses[chosen]  # as good as others because hardly a pixel belongs to it
    raise ValueError(
        f"{int(film.moving.sum())} pixels change, and no body was found along whose motion they keep their "
        "colours: the latents may be no coordinates of a mechanism. Look at reconstruction.png and latent.png"
    )


def choose_parts(film: FilmRegistration, regions: Sequence[Region], bending: int) -> list[FittedBody]:
    """A body of the pixels that a rigid motion of each region explains best; poor ones are left out."""
    labels = label_pixels(film, [film.fit_motion(film.choose_points(region), 0) for region in regions])
    owned = [film.moving & (labels == number) for number in range(len(regions))]
    parts = [choose_body(film, region, bending) for region in owned if region.sum() >= FEWEST]
    while len(parts) > 1 and (poor := find_poor_bodies(film, parts)):
        parts = [part for number, part in enumerate(parts) if number not in poor]
    return parts


def find_simplest(losses: Sequence[Float64[np.ndarray, " B"]]) -> int:
    """The first of some fits, simple ones first, with a mean loss within a standard error of the least."""
    best = min(losses, key=np.mean)
    limit = best.mean() + best.std() / np.sqrt(len(best))
    return next(number for number, each in enumerate(losses) if each.mean() <= limit)


def find_poor_bodies(film: FilmRegistration, bodies: Sequence[FittedBody]) -> list[int]:
    """Numbers of bodies to which hardly a pixel belongs, or whose pixels hardly keep their colours."""
    reports = report_bodies(film, bodies, list_points(film, bodies))
    return [i for i, each in enumerate(reports) if each.pixels < FEWEST or each.explained < LEAST_EXPLAINED]


def choose_body(film: FilmRegistration, region: Region, bending: int) -> FittedBody:
    """The simplest motion that explains withheld frames of a region as well as the best one does."""
    tried, losses = fit_degrees(film, region, bending)
    return tried[find_simplest(losses)]


def fit_degrees(
    film: FilmRegistration, region: Region, bending: int
) -> tuple[list[FittedBody], list[Float64[np.ndarray, " B"]]]:
    """A body of a region for each degree of bending, and their losses in withheld frames.

    A body that folds would be matter that passes through itself: several bodies were taken for one, or a
    shadow and what throws it. It is left out.
    """
    points = film.choose_points(region)
    fitted = [film.fit_motion(points, degree) for degree in range(bending + 1)]
    scale = min(each.scale for each in fitted)
    weight = film.weigh(points, scale=scale)
    still = film.measure_losses(None, points, scale=scale, chosen=film.withheld).mean(0)
    tried, losses = [], []
    for each in fitted:
        loss = film.measure_losses(each.motion, points, scale=scale, chosen=film.withheld)
        own = torch.from_numpy(still - loss.mean(0) > CLEARLY)
        if not each.motion.folds(points[own], film.q):
            tried.append(each)
            losses.append(loss @ weight)
    means = tuple(float(each.mean()) for each in losses)
    return [replace(each, losses=means) for each in tried], losses


def split_region(film: FilmRegistration, region: Region, most: int) -> list[Region]:
    """Split a region by rigid motions: that of the part that most pixels follow, and so on with the others.

    The motion of a part is fitted to a window, which holds one body if it is small. Its loss has the scale of
    most windows.

    Source: random sample consensus (Fischler and Bolles, 1981), with windows in place of random samples.
    """
    left = region.copy()
    regions: list[Region] = []
    while len(regions) < most and left.sum() >= FEWEST:
        windows = [film.fit_motion(points, 0) for points in cut_windows(film.choose_points(left), film.size)]
        scale = float(np.median([each.scale for each in windows]))
        points = film.points[torch.from_numpy(np.flatnonzero(left.ravel()))]
        follow = []
        for each in windows:
            loss = np.ones(left.size)
            kept = film.measure_losses(each.motion, points, scale=scale, chosen=film.kept)
            loss[left.ravel()] = kept.mean(0)
            follow.append(left & (gaussian_filter(loss.reshape(left.shape), LABEL_BLUR_PX) < UNEXPLAINED))
        largest = max(follow, key=np.sum)
        if largest.sum() < FEWEST:
            break
        regions.append(largest)
        left &= ~largest
    return regions


def cut_windows(points: Points, size: float) -> list[Points]:
    """Round parts of a region, about places that are far from one another, with `FEWEST` points at least."""
    center = points[(points - points.mean(0)).norm(dim=1).argmax()]
    away = torch.full((len(points),), torch.inf, dtype=points.dtype)
    windows = []
    for _ in range(WINDOWS):
        distance = (points - center).norm(dim=1)
        inside = points[distance <= WINDOW * size]
        if len(inside) >= FEWEST:
            windows.append(inside)
        away = torch.minimum(away, distance)
        center = points[away.argmax()]
    return windows or [points]


def measure_least_losses(
    film: FilmRegistration, bodies: Sequence[FittedBody], *, scale: float
) -> Float64[np.ndarray, " B"]:
    """Mean loss of what moves in each withheld frame.

    Each pixel moves with the body, or stands still, as explains it best in the other frames.
    """
    points = film.choose_points(film.moving)
    motions = [None, *(each.motion for each in bodies)]
    kept, withheld = (
        np.stack([film.measure_losses(each, points, scale=scale, chosen=chosen) for each in motions])
        for chosen in (film.kept, film.withheld)
    )
    number = kept.mean(1).argmin(0)
    return withheld[number, :, np.arange(len(points))].T @ film.weigh(points, scale=scale)


def map_losses(film: FilmRegistration, bodies: Sequence[FittedBody]) -> Float64[np.ndarray, "n H W"]:
    """Mean loss of every pixel over all frames, if it stands still and if it moves with each body."""
    scale, every = min(each.scale for each in bodies), np.arange(len(film.q))
    motions: list[BodyMotion | None] = [None, *(each.motion for each in bodies)]
    losses = [film.measure_losses(each, film.points, scale=scale, chosen=every).mean(0) for each in motions]
    return np.stack(losses).reshape(-1, film.height, film.width)


def label_pixels(film: FilmRegistration, bodies: Sequence[FittedBody]) -> Int[np.ndarray, "H W"]:
    """Number of the body of each pixel at the mean state; -1 for the still background.

    A pixel belongs to the body along whose motion it keeps its colour best, if standing still keeps it
    clearly worse. What has its colour in most frames is background, unless a body surrounds it.
    """
    still, *moved = (gaussian_filter(each, LABEL_BLUR_PX) for each in map_losses(film, bodies))
    clear = film.moving & (still - np.min(moved, axis=0) > CLEARLY)
    labels = np.where(clear, np.argmin(moved, axis=0), -1)
    for number in range(len(bodies)):
        labels[binary_fill_holes(labels == number) & (labels < 0) & film.known] = number
    return labels


def find_unexplained(film: FilmRegistration, bodies: Sequence[FittedBody]) -> Region:
    """Moving pixels whose colour neither a body nor the still background keeps."""
    least = gaussian_filter(map_losses(film, bodies).min(0), LABEL_BLUR_PX)
    return film.moving & (least > UNEXPLAINED)


def list_points(film: FilmRegistration, bodies: Sequence[FittedBody]) -> list[Points]:
    """Pixels at the mean state that belong to each body."""
    labels = label_pixels(film, bodies).ravel()
    return [film.points[torch.from_numpy(np.flatnonzero(labels == i))] for i in range(len(bodies))]


def report_bodies(
    film: FilmRegistration, bodies: Sequence[FittedBody], owned: Sequence[Points]
) -> list[BodyReport]:
    """What a fit says of bodies and the points that belong to them."""
    reports = []
    for body, points in zip(bodies, owned, strict=True):
        explained = 0.0
        if len(points):
            weight = film.weigh(points, scale=body.scale)
            moved, stayed = (
                (film.measure_losses(motion, points, scale=body.scale, chosen=film.withheld) @ weight).mean()
                for motion in (body.motion, None)
            )
            explained = float(1.0 - moved / stayed)
        reports.append(BodyReport(len(points), list(body.losses), body.motion.bending, body.scale, explained))
    return reports
