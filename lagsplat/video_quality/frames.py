"""Prepare frames (rotate, crop, resize, thumbnails) and measure frames per period of the motion."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Float64, UInt8

SIDE = 32
MOST_FRAMES = 1200  # of a stretch: all pairs are multiplied
COMPONENTS = 5
BAND = 0.12  # half width of a spectral line with side lobes, as a share of its frequency
LEAST_SHARE = 0.01  # share of the variance that a band must contain to be a motion
CONTRAST = 3.0  # ratio to the density of the bands on either side
SUBHARMONIC = 0.25  # share of a band's power that makes its half or third the fundamental
PADDING = 8


@dataclass(frozen=True)
class SamplingRate:
    """Dominant period [s] of the motion, and frames per period."""

    period_s: float
    samples: float


def measure_samples_per_period(
    grey: Float32[np.ndarray, "T h w"], time_s: Float64[np.ndarray, " T"]
) -> SamplingRate | None:
    """The period at which the leading principal components of the frames have most kinetic energy.

    Energy is power times squared frequency: a slow push may be large and still not be the motion. A small
    object that crosses many pixels has overtones, so a half or a third of the frequency is preferred if it
    has power; near the Nyquist limit such overtones alias and can hide the period. None if no band stands
    out of the noise.
    """
    grey, time_s = grey[:MOST_FRAMES], time_s[:MOST_FRAMES]
    small = np.stack([cv2.resize(frame, (SIDE, SIDE), interpolation=cv2.INTER_AREA) for frame in grey])
    flat = small.reshape(len(small), -1).astype(np.float64)
    flat -= flat.mean(axis=0)
    values, vectors = np.linalg.eigh(flat @ flat.T)
    if values[-1] <= 1e-9:
        return None
    even = np.linspace(time_s[0], time_s[-1], len(time_s))
    spacing_s = float(even[1] - even[0])
    power = np.zeros(PADDING * len(even) // 2 + 1)
    for value, vector in zip(values[-COMPONENTS:], vectors.T[-COMPONENTS:], strict=True):
        component = np.interp(even, time_s, vector)
        spectrum = np.fft.rfft((component - component.mean()) * np.hanning(len(even)), PADDING * len(even))
        power += max(float(value), 0.0) * np.abs(spectrum) ** 2
    frequency = np.fft.rfftfreq(PADDING * len(even), spacing_s)
    slowest = 1.5 / (even[-1] - even[0])
    power[frequency < slowest] = 0.0
    band = _strongest_band(frequency, power, slowest)
    if band is None:
        return None
    near = (frequency > (1 - BAND) * band) & (frequency < (1 + BAND) * band)
    centre = float(frequency[near][np.argmax(power[near])])
    return SamplingRate(period_s=1.0 / centre, samples=1.0 / (centre * spacing_s))


def _strongest_band(
    frequency: Float64[np.ndarray, " F"], power: Float64[np.ndarray, " F"], slowest: float
) -> float | None:
    """Centre of the band with most kinetic energy among those that stand out, or its subharmonic."""

    def density(low: float, high: float) -> float:
        inside = (frequency > low) & (frequency < high)
        return float(power[inside].mean()) if inside.any() else 0.0

    def content(centre: float, weight: Float64[np.ndarray, " F"]) -> float:
        return float(weight[(frequency > (1 - BAND) * centre) & (frequency < (1 + BAND) * centre)].sum())

    best, most = None, 0.0
    for centre in np.geomspace(slowest, frequency[-1], 150):
        flanks = max(density(0.6 * centre, 0.8 * centre), density(1.25 * centre, 1.6 * centre))
        stands_out = density((1 - BAND) * centre, (1 + BAND) * centre) > CONTRAST * flanks
        kinetic = content(centre, power * frequency**2)
        if stands_out and kinetic > most and content(centre, power) > LEAST_SHARE * power.sum():
            best, most = float(centre), kinetic
    while best is not None:
        below = [
            part
            for part in (best / 2, best / 3)
            if part > slowest and content(part, power) > SUBHARMONIC * content(best, power)
        ]
        if not below:
            break
        best = max(below, key=lambda part: content(part, power))
    return best


TURNS = {90: cv2.ROTATE_90_CLOCKWISE, 180: cv2.ROTATE_180, 270: cv2.ROTATE_90_COUNTERCLOCKWISE}
HALVED_FROM = 4.0  # pixels of the image per pixel of the frame, above which halving first is invisible


def crop_and_resize(
    picture: UInt8[np.ndarray, "h w 3"],
    *,
    crop: Sequence[int] | None,
    size: tuple[int, int] | None,
    source: str,
    grey: bool = False,
) -> UInt8[np.ndarray, "H W 3"]:
    """Convert a BGR image to an RGB frame.

    Args:
        picture: The image.
        crop: (x, y, width, height) [pixel]; None keeps the whole image.
        size: (height, width) after averaging over areas; None keeps the cropped size.
        source: Name of the image in errors.
        grey: Make the three channels equal, the luma of ITU-R BT.601.

    Raises:
        ValueError: the crop reaches outside the image.
    """
    rows, columns = picture.shape[:2]
    x, y, width, height = crop if crop is not None else (0, 0, columns, rows)
    if min(x, y) < 0 or min(width, height) < 1 or x + width > columns or y + height > rows:
        raise ValueError(
            f"{source}: crop {[x, y, width, height]} (x, y, width, height) reaches outside the picture, "
            f"which is {columns} wide and {rows} high; make it smaller"
        )
    picture = picture[y : y + height, x : x + width]
    if size is not None:
        picture = average_areas(picture, size)
    if grey:
        return cv2.cvtColor(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2RGB)
    return cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)


def rotate_image(picture: UInt8[np.ndarray, "h w 3"], degrees: int) -> UInt8[np.ndarray, "H W 3"]:
    """Rotate ``picture`` clockwise by 0, 90, 180 or 270 ``degrees``."""
    return cv2.rotate(picture, TURNS[degrees]) if degrees else picture


def average_areas(picture: UInt8[np.ndarray, "h w *c"], size: tuple[int, int]) -> UInt8[np.ndarray, "H W *c"]:
    """Resize ``picture`` to ``size`` (height, width) by averaging over areas.

    Even sides that shrink fourfold or more are halved first: OpenCV averages whole pixels many times faster
    than fractions, and frames of noise differ by less than one of 255 levels on average.
    """
    rows, columns = picture.shape[:2]
    if not rows % 2 and not columns % 2 and min(rows / size[0], columns / size[1]) >= HALVED_FROM:
        picture = cv2.resize(picture, (columns // 2, rows // 2), interpolation=cv2.INTER_AREA)
    return cv2.resize(picture, (size[1], size[0]), interpolation=cv2.INTER_AREA)


MOST = 300
LONGEST_SIDE = 160  # pixels


class Thumbnails:
    """At most 300 small images of a video of unknown length, evenly spaced, at most 160 pixels a side.

    Every k-th image is kept, the first included; beyond 300, every other one is dropped and k doubles.
    """

    def __init__(self) -> None:
        self.pictures: list[UInt8[np.ndarray, "h w"]] = []
        """Grey thumbnails, in order."""
        self._every, self._seen = 1, 0
        self.scale = 1.0
        """Pixels of the image per pixel of the thumbnail."""
        self.width = 0
        """Size of the images [pixel]."""

    def add(self, picture: UInt8[np.ndarray, "H W 3"]) -> None:
        """Keep ``picture`` (BGR) if it is its turn."""
        if self._seen % self._every == 0:
            self.width = picture.shape[1]
            self.scale = max(1.0, max(picture.shape[:2]) / LONGEST_SIDE)
            size = (round(picture.shape[0] / self.scale), round(picture.shape[1] / self.scale))
            small = cv2.cvtColor(
                average_areas(picture, (max(1, size[0]), max(1, size[1]))), cv2.COLOR_BGR2GRAY
            )
            self.pictures.append(small)
        self._seen += 1
        if len(self.pictures) > MOST:
            self.pictures = self.pictures[::2]
            self._every *= 2


def make_small_grey(frames: UInt8[np.ndarray, "T H W 3"], *, most: int) -> Float32[np.ndarray, "T h w"]:
    """All ``frames`` in grey, so small that together they have ``most`` pixels, and at most 160 a side."""
    rows, columns = frames.shape[1:3]
    scale = max(1.0, max(rows, columns) / LONGEST_SIDE, (len(frames) * rows * columns / most) ** 0.5)
    size = (max(1, round(rows / scale)), max(1, round(columns / scale)))
    small = np.empty((len(frames), *size), np.float32)
    for i, frame in enumerate(frames):
        grey = cv2.cvtColor(np.ascontiguousarray(frame), cv2.COLOR_RGB2GRAY).astype(np.float32)
        small[i] = grey if scale == 1.0 else cv2.resize(grey, size[::-1], interpolation=cv2.INTER_AREA)
    return small
