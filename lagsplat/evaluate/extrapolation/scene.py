"""The clip past whose training frames models are compared, and which frames its encoder understands.

States of frames unlike the training frames are not meaningful.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32, Float64
from scipy.spatial import cKDTree

from lagsplat.chart.chart import Chart
from lagsplat.chart.trajectory import TimeBase
from lagsplat.evaluate.config import ExtrapolationConfig
from lagsplat.evaluate.evaluate import make_picture_reader, require_same_run
from lagsplat.evaluate.forecast import image_errors
from lagsplat.evaluate.modes import fit_modes, root_of_metric
from lagsplat.evaluate.protocol import Pictures
from lagsplat.evaluate.spectrum import resample_evenly
from lagsplat.integer_lists import choose_evenly
from lagsplat.io.recording.recording import Recording
from lagsplat.io.recording.segments import find_crossing_frames
from lagsplat.stage1.autoencoder import CHUNK, Autoencoder, decode_latents
from lagsplat.stage2.lagrangian import Lagrangian

MOST = 1000  # most training frames on which the reconstruction error is measured


@dataclass(frozen=True)
class BoundaryClip:
    """Latents of one clip, not smoothed: frames ``start`` to ``stop`` of the recording, of which those from
    ``boundary`` on are held out. ``period_s`` [s] is the natural period of its training part.
    """

    start: int
    boundary: int
    stop: int
    dt_s: float
    period_s: float
    latents: Float64[np.ndarray, "T d"]
    time_s: Float64[np.ndarray, " T"]
    metric: Float64[np.ndarray, "d d"]
    even: bool

    @property
    def n_train(self) -> int:
        """Number of training frames in the clip."""
        return self.boundary - self.start

    @property
    def ahead(self) -> Float64[np.ndarray, " held"]:
        """Instants of the held-out frames, in median spacings from the last training frame."""
        return self.places[self.n_train :] - self.places[self.n_train - 1]

    @property
    def places(self) -> Float64[np.ndarray, " T"]:
        """Instants of all frames, in median spacings from the first."""
        return (self.time_s - self.time_s[0]) / self.dt_s

    @property
    def clock(self) -> TimeBase:
        """The time base of the frames."""
        return TimeBase(self.dt_s, None if self.even else self.time_s)

    def history(self, periods: float) -> int:
        """Number of training frames in this many natural periods: at least four, at most all."""
        return int(np.clip(round(periods * self.period_s / self.dt_s), min(4, self.n_train), self.n_train))


def choose_boundary_clip(chart: Chart) -> BoundaryClip:
    """The clip of a chart that holds both training and held-out frames.

    Raises:
        ValueError: there is none, the mechanism is driven, or its training part shows no oscillation.
    """
    start, boundary, stop = find_crossing_frames(chart.segments, chart.n_train)
    if chart.inputs.shape[1] and np.ptp(chart.inputs[start:stop], axis=0).max() > 0:
        raise ValueError(
            "the clip is driven by inputs, and a forecaster of pictures knows none; take a free system"
        )
    clock = chart.whole.clock
    train = resample_evenly(chart.latents[start:boundary], clock, start=start)
    modes = fit_modes(train, dt_s=chart.dt_s, metric=chart.metric, most=1)
    if not modes:
        raise ValueError("the training part of the clip shows no oscillation to take a natural period from")
    return BoundaryClip(
        start=start,
        boundary=boundary,
        stop=stop,
        dt_s=chart.dt_s,
        period_s=1.0 / modes[0].frequency_hz,
        latents=chart.latents[start:stop],
        time_s=chart.time_s[start:stop],
        metric=chart.metric,
        even=clock.time_s is None,
    )


@dataclass(frozen=True)
class StateReading:
    """States encoded from predicted frames, and which of these are in range.

    ``error`` is the mean squared reconstruction error of each frame over that of the worst training frame,
    ``distance`` that of its state from the nearest training state over their rms.
    """

    states: Float64[np.ndarray, "N d"]
    error: Float64[np.ndarray, " N"]
    distance: Float64[np.ndarray, " N"]
    inside: Bool[np.ndarray, " N"]


def summarize_readings(readings: list[StateReading]) -> dict[str, Any]:
    """Share of the frames of several readings that are in range, as plain data."""
    if not readings:
        return {"frames": 0, "inside": 0.0}
    error, distance, inside = (
        np.concatenate([getattr(reading, name) for reading in readings])
        for name in ("error", "distance", "inside")
    )
    return {
        "frames": len(inside),
        "inside": float(inside.mean()),
        "worst_error": float(error.max()),
        "median_error": float(np.median(error)),
        "worst_distance": float(distance.max()),
    }


@dataclass(frozen=True)
class Scene:
    """A trained run, the clip on which models are compared, and the training states of its encoder.

    ``pictures`` gives recorded images by frame number. ``worst_error`` is the reconstruction error of the
    worst training frame. ``tree`` holds the training states times ``root``, where distances are those of the
    metric, and ``scale`` is their rms distance from their mean.
    """

    autoencoder: Autoencoder
    chart: Chart
    lagrangian: Lagrangian
    config: ExtrapolationConfig
    pictures: Pictures
    clip: BoundaryClip
    worst_error: float
    scale: float
    root: Float64[np.ndarray, "d d"]
    tree: cKDTree

    def render(self, states: Float64[np.ndarray, "N d"]) -> Float32[np.ndarray, "N 3 H W"]:
        """Images of whitened states, by the decoder of the run."""
        return decode_latents(self.autoencoder, self.chart.to_raw(states))

    def to_states(self, images: Float32[np.ndarray, "N 3 H W"]) -> Float64[np.ndarray, "N d"]:
        """Whitened latents of images in [0, 1]; NaN where a pixel is.

        Raises:
            ValueError: the images are of another size than the encoder's.
        """
        size = (self.autoencoder.height, self.autoencoder.width)
        if images.shape[2:] != size:
            raise ValueError(
                f"predicted frames of {images.shape[2]} x {images.shape[3]} pixels, but the encoder was "
                f"trained on {size[0]} x {size[1]}; predict frames of the size that was trained on"
            )
        frames = np.clip(np.moveaxis(np.nan_to_num(images), 1, 3), 0.0, 1.0)
        states = self.chart.encode(self.autoencoder, np.round(255.0 * frames).astype(np.uint8))
        states[np.isnan(images).any(axis=(1, 2, 3))] = np.nan
        return states

    def read(self, images: Float32[np.ndarray, "N 3 H W"]) -> StateReading:
        """Encode predicted images and check whether each is in range.

        Raises:
            ValueError: the images are of another size than the encoder's.

        Source: paper, "What the Lagrangian prior buys": an encoded state is meaningful only for images like
        those that the encoder was trained on.
        """
        states = self.to_states(images)
        error = image_errors(self.render(states), np.clip(images, 0.0, 1.0)) / max(self.worst_error, 1e-12)
        distance = self.tree.query(states @ self.root)[0] / self.scale
        inside = (error <= self.config.range_error) & (distance <= self.config.range_distance)
        return StateReading(states, error, distance, inside)


def open_scene(
    autoencoder: Autoencoder,
    chart: Chart,
    lagrangian: Lagrangian,
    recording: Recording,
    config: ExtrapolationConfig,
) -> Scene:
    """Choose the clip of a trained run, and collect the states that its encoder knows.

    Raises:
        ValueError: recording, chart and autoencoder do not belong together, or as `choose_boundary_clip`.
    """
    require_same_run(autoencoder, chart, recording)
    pictures, clip = make_picture_reader(recording, first=0), choose_boundary_clip(chart)
    states, chosen = chart.train.latents, choose_evenly(chart.n_train, MOST)
    errors = [
        image_errors(decode_latents(autoencoder, chart.to_raw(states[part])), pictures(part)).max()
        for part in np.array_split(chosen, max(1, len(chosen) // CHUNK))
    ]
    root = root_of_metric(chart.metric)
    known = states @ root
    return Scene(
        autoencoder=autoencoder,
        chart=chart,
        lagrangian=lagrangian,
        config=config,
        pictures=pictures,
        clip=clip,
        worst_error=float(max(errors)),
        scale=float(np.sqrt(np.square(known - known.mean(axis=0)).sum(axis=1).mean())),
        root=root,
        tree=cKDTree(known),
    )
