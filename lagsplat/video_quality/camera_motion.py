"""Measure and undo the camera's motion, from the background of a video.

Lucas-Kanade finds corners of the first image in all others. The background of an image is a set of corners
that are spread over it and moved by one shift, turn and zoom. First it is asked whether such a set stayed
where it was, then whether one stayed where the background of the image before was: a few corners suffice,
however much of the picture a moving body covers. Only where there is none, what most corners agree on counts.
A static border or caption would be taken for the background.

Source: Lucas and Kanade 1981; Bouguet 2001 for the pyramid.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Complex128, Float32, Float64, UInt8
from scipy.ndimage import uniform_filter1d
from scipy.stats import binom

MOST_CORNERS = 200
WINDOW = 15  # pixels of the search window
LEVELS = 3  # of the pyramid, where corners went far
LARGEST_RESIDUAL = 15.0  # largest mean absolute difference of a tracked corner [levels of 255]
ALIKE = 0.3  # corners that follow one motion are at most this far from it [pixel]...
FINEST = 0.1  # ...which is lowered to where 99 % of their errors lie, but not below this [pixel]
RAYLEIGH = float(np.sqrt(np.log(100.0) / np.log(2.0)))  # that quantile of a distance, over its median
FEWEST = 6  # corners of a background...
CHANCE = 1e-6  # ...and more than agree by chance in this share of images
NEAR = 1.0  # corners that may follow a motion are at most this far from its first guess [pixel]
# The bounding box of the background covers at least this share of the image. Where corners within FINEST of a
# turn's or zoom's centre pass for a still background, the image moves by less than twice FINEST rms.
SPREAD = 0.2
ROUNDS = 10  # of fitting the motion and choosing its corners

Corners = Float32[np.ndarray, "N 1 2"]
Chosen = Bool[np.ndarray, " N"]
Motion = Complex128[np.ndarray, " 2"]
"""Shift at the middle of the image [pixel], and turn and zoom, of places and displacements x + iy."""
STILL = np.zeros(2, np.complex128)


@dataclass(frozen=True)
class CameraMotion:
    """Displacement of the image since the first frame, rms over the image [pixel of the video]."""

    rms_px: float  # spread of the path about its mean
    max_px: float  # largest displacement
    drift_px: float  # largest displacement of the running mean over a tenth of the video
    jitter_px: float  # rms of the rest


def track_background(pictures: Iterable[UInt8[np.ndarray, "h w"]]) -> Float64[np.ndarray, "T 4 2"] | None:
    """Displacement (x, y) of the background since the first image [pixel], NaN where it is hidden.

    It is given at four places about the middle of the image. Their mean is the displacement of the middle,
    and their mean square that over the whole image (Gauss' quadrature). None if no background can be
    measured in half of the images or more.
    """
    following = iter(pictures)
    first = next(following)
    start = cv2.goodFeaturesToTrack(first, MOST_CORNERS, 0.02, max(4, max(first.shape) // 30))
    if start is None or len(start) < FEWEST:
        return None
    motions = np.stack([STILL, *_follow(first, following, start)])
    if np.isnan(motions[1:, 0]).sum() * 2 >= len(motions):
        return None
    across, down = (side / np.sqrt(12.0) for side in first.shape[::-1])
    places = np.array([across + 1j * down, across - 1j * down, -across + 1j * down, -across - 1j * down])
    path = motions[:, :1] + motions[:, 1:] * places
    return np.stack([path.real, path.imag], axis=-1)


def measure_path(path: Float64[np.ndarray, "T 4 2"]) -> CameraMotion:
    """Statistics of a path [pixel]; images with a hidden background do not count."""
    path = path[np.isfinite(path[:, 0, 0])]
    path = path - path[0]
    slow = uniform_filter1d(path, max(1, len(path) // 10), axis=0, mode="nearest")

    def sizes(x: Float64[np.ndarray, "T 4 2"]) -> Float64[np.ndarray, " T"]:
        return np.sqrt((x**2).sum(axis=2).mean(axis=1))

    def rms(x: Float64[np.ndarray, "T 4 2"]) -> float:
        return float(np.sqrt((sizes(x) ** 2).mean()))

    return CameraMotion(
        rms_px=rms(path - path.mean(axis=0)),
        max_px=float(sizes(path).max()),
        drift_px=float(sizes(slow - slow[0]).max()),
        jitter_px=rms(path - slow),
    )


def _follow(
    first: UInt8[np.ndarray, "h w"],
    following: Iterable[UInt8[np.ndarray, "h w"]],
    start: Corners,
) -> Iterator[Motion]:
    """The motion of each image since the first, NaN where none is found.

    Always tracked from the first image, so that errors do not accumulate.
    """
    last = STILL
    for picture in following:
        pair = _Pair(first, picture, start)
        found = pair.find_still()
        if found is None or np.abs(pair.move(last)).max() > NEAR:
            # a repeated pattern seems still one period away; where it was before, more of its corners agree
            near = [pair.find_near(guess) for guess in (last, STILL)]
            found = _take_most(*near, found) or pair.find_far(last)
        last = last if found is None else found[0]
        yield np.full(2, np.nan, np.complex128) if found is None else last


def _take_most(*fits: tuple[Motion, Chosen] | None) -> tuple[Motion, Chosen] | None:
    """The fit of most corners."""
    return max((fit for fit in fits if fit is not None), key=lambda fit: fit[1].sum(), default=None)


class _Pair:
    """The first image of a video and another one, with corners of the first."""

    def __init__(
        self, first: UInt8[np.ndarray, "h w"], second: UInt8[np.ndarray, "h w"], start: Corners
    ) -> None:
        self.first, self.second, self.start = first, second, start
        middle = 0.5 * np.array(first.shape[::-1])
        self.places = (start[:, 0] - middle).astype(np.float64) @ np.array([1.0, 1j])

    def find_still(self) -> tuple[Motion, Chosen] | None:
        """No motion, and the corners that stayed where they were; None where they are too few."""
        chosen = np.abs(self.track(STILL, 0)) <= FINEST
        return (STILL, chosen) if self.suffices(chosen, FINEST) else None

    def find_near(self, guess: Motion) -> tuple[Motion, Chosen] | None:
        """The motion near a guess that some corners follow, and which do; None where they are too few."""
        return self.fit(self.track(guess, 0), guess)

    def find_far(self, last: Motion) -> tuple[Motion, Chosen] | None:
        """The motion that most of the corners follow which are found again."""
        fits = []
        # At the top of a pyramid a window is as large as the image, and a large body moves all of it.
        for levels in range(LEVELS + 1):
            moved = self.track(last, levels)
            alike = np.abs(moved[:, None] - moved) <= NEAR
            guess = np.array([moved[alike.sum(axis=0).argmax()], 0.0])
            moved = self.track(guess, 0)
            found = self.fit(moved, guess)
            if found is not None:
                near = np.abs(moved - self.move(found[0])) <= NEAR
                fits += [found] if 2 * near.sum() > np.isfinite(moved).sum() else []
        return _take_most(*fits)

    def track(self, guess: Motion, levels: int) -> Complex128[np.ndarray, " N"]:
        """Displacements of the corners, searched from a guess; NaN where one is lost."""
        shift = self.move(guess)
        begin = self.start + np.stack([shift.real, shift.imag], axis=-1)[:, None].astype(np.float32)
        now, status, residual = cv2.calcOpticalFlowPyrLK(
            self.first,
            self.second,
            self.start,
            begin,
            winSize=(WINDOW, WINDOW),
            maxLevel=levels,
            criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.003),
            flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        )
        lost = (status[:, 0] == 0) | (residual[:, 0] > LARGEST_RESIDUAL)
        return np.where(lost, np.nan, (now - self.start)[:, 0].astype(np.float64) @ np.array([1.0, 1j]))

    def move(self, motion: Motion) -> Complex128[np.ndarray, " N"]:
        """Displacements of the corners by a motion."""
        return motion[0] + motion[1] * self.places

    def fit(self, moved: Complex128[np.ndarray, " N"], guess: Motion) -> tuple[Motion, Chosen] | None:
        """The motion near a guess that corners follow, and which do; None for too few."""
        motion, chosen, reach = guess, np.zeros(len(moved), bool), NEAR
        for _ in range(ROUNDS):
            before, chosen = chosen, np.abs(moved - self.move(motion)) <= reach  # false for NaN
            if not self.suffices(chosen, NEAR):
                return None
            if np.array_equal(chosen, before):
                break
            terms = np.stack([np.ones(chosen.sum()), self.places[chosen]], axis=1)
            motion = np.linalg.lstsq(terms, moved[chosen], rcond=None)[0]
            median = np.median(np.abs(moved - self.move(motion))[chosen])
            reach = float(np.clip(RAYLEIGH * median, FINEST, ALIKE))
        return motion, chosen

    def suffices(self, chosen: Chosen, reach: float) -> bool:
        """Whether corners are enough for a background, and spread over the image.

        More than may be found by chance within ``reach`` [pixel] of a place: a corner that is hidden ends
        anywhere in its window.
        """
        if chosen.sum() <= max(FEWEST - 1, binom.isf(CHANCE, len(chosen), np.pi * reach**2 / WINDOW**2)):
            return False
        return bool(np.ptp(self.start[chosen, 0], axis=0).prod() >= SPREAD * self.first.size)


def path_to_undo(pictures: Iterable[UInt8[np.ndarray, "h w"]], *, source: str) -> Float64[np.ndarray, "T 2"]:
    """Displacement (x, y) of the background at the middle of each grey image since the first [pixel].

    Raises:
        ValueError: the background cannot be measured, in all images or in one.
    """
    path = track_background(pictures)
    if path is None:
        raise ValueError(
            f"{source}: recording.stabilise needs a background that can be followed, but too few corners "
            "stand still or move alike; set it to false, or film with something textured behind the system"
        )
    hidden = np.flatnonzero(np.isnan(path[:, 0, 0]))
    if hidden.size:
        raise ValueError(
            f"{source}: recording.stabilise cannot follow the background in {hidden.size} of {len(path)} "
            f"frames, the first of them frame {hidden[0]} of those kept; cut them off with recording.skip_s "
            "and end_s, or set it to false"
        )
    return path.mean(axis=1)


def shift_back(
    picture: UInt8[np.ndarray, "h w 3"], moved: Float64[np.ndarray, " 2"]
) -> UInt8[np.ndarray, "h w 3"]:
    """Shift ``picture`` back by its displacement (x, y) [pixel]; the border is replicated.

    Cubic interpolation; rotation and scale are not corrected.
    """
    back = np.array([[1.0, 0.0, moved[0]], [0.0, 1.0, moved[1]]])
    return cv2.warpAffine(
        picture,
        back,
        (picture.shape[1], picture.shape[0]),
        flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
