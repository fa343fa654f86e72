"""The chart: whitened latents of a recording with their metric, and its file."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.array_types import Frames, Images, Latents, Series
from lagsplat.chart import visibility
from lagsplat.chart.config import ChartConfig
from lagsplat.chart.refinement import refine_latents
from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.chart.visibility import Whitening
from lagsplat.io.files.artifact import load_artifact, require_settings, save_artifact
from lagsplat.io.recording.recording import Recording
from lagsplat.stage1.autoencoder import CHUNK, Autoencoder, decode_latents, encode_frames, to_images

KIND = "chart"
SCHEMA = 1
ARRAYS = ("mean", "whiten", "unwhiten", "metric", "latents", "inputs", "time_s", "rest")
SETTINGS = (
    *("n_train", "segments", "metric_scale", "smoothing_frames", "condition", "intrinsic_dimension"),
    *("refinement_steps", "visibility_step"),
)


@dataclass(frozen=True)
class Chart(Whitening):
    """Whitened latents of a recording, not smoothed, with the metric they are measured in.

    ``q = (z - mean) @ whiten``, ``z = mean + q @ unwhiten``. ``metric`` has trace ``d`` and no ridge;
    ``metric * metric_scale`` is the mean squared image change per whitened unit, summed over pixels and
    channels. ``rest`` encodes the rest image. The first ``n_train`` frames are for training.
    ``smoothing_frames`` is the sigma with which later stages smooth latents and inputs, in median spacings.

    Example:
        >>> import lagsplat
        >>> chart = lagsplat.open_run("run").chart
        >>> chart.latents.shape[1] == chart.d
        True
    """

    metric: Float64[np.ndarray, "d d"]
    metric_scale: float
    latents: Float64[np.ndarray, "T d"]
    inputs: Float64[np.ndarray, "T n_u"]
    time_s: Float64[np.ndarray, " T"]
    rest: Float64[np.ndarray, " d"]
    n_train: int
    segments: tuple[tuple[int, int], ...]
    smoothing_frames: float
    condition: float
    intrinsic_dimension: float
    refinement_steps: int
    visibility_step: float

    def encode(self, autoencoder: Autoencoder, frames: Frames) -> Series:
        """Whitened latents of other frames, found as those of the recording were."""
        q = self.to_whitened(encode_frames(autoencoder, frames))
        steps, difference = self.refinement_steps, self.visibility_step
        return refine_whitened(autoencoder, self, frames, q, steps=steps, difference=difference)

    @property
    def d(self) -> int:
        """Latent dimension."""
        return len(self.mean)

    @property
    def dt_s(self) -> float:
        """Median time between two frames of one clip [s]."""
        return self.whole.dt_s

    @cached_property
    def whole(self) -> EncodedTrajectory:
        """The trajectory of all frames, not smoothed."""
        return EncodedTrajectory(self.latents, self.inputs, self.time_s, self.segments)

    @property
    def train(self) -> EncodedTrajectory:
        """The training part, not smoothed."""
        return self.whole.part(0, self.n_train)

    @property
    def held_out(self) -> EncodedTrajectory:
        """The held-out part, which no fit uses, not smoothed."""
        return self.whole.part(self.n_train, len(self.latents))


def find_rest_image(recording: Recording, *, n_train: int, rest_frames: int) -> np.ndarray:
    """Per-pixel median of the first training frames, uint8 (1, H, W, 3)."""
    frames = np.asarray(recording.frames[: min(rest_frames, n_train)])
    return np.round(np.median(frames, axis=0, keepdims=True)).astype(np.uint8)


def fit_chart(autoencoder: Autoencoder, recording: Recording, config: ChartConfig, *, seed: int = 0) -> Chart:
    """Encode a recording, whiten its latents and measure how visible they are.

    Only training frames decide the whitening, the metric and the dimension. ``seed`` draws the frames that
    measure the last two.

    Raises:
        ValueError: a latent axis without variance, a recording that is not divided, or a metric that cannot
            be measured.

    Source: paper, "Reading the chart" and Implementation Details.
    """
    n_train = recording.split()[0].n_frames
    z = encode_frames(autoencoder, recording.frames)
    white = visibility.fit_whitening(z[:n_train], eigenvalue_floor=config.eigenvalue_floor)
    decode = partial(decode_whitened, autoencoder, white)
    steps, difference = config.refinement_steps, config.visibility_step
    refine = partial(refine_whitened, autoencoder, white, steps=steps, difference=difference)
    q = refine(recording.frames, white.to_whitened(z))

    rng = np.random.default_rng(seed)
    seen = rng.choice(n_train, min(config.visibility_frames, n_train), replace=False)
    visible = visibility.measure_visibility(decode, q[np.sort(seen)], step=config.visibility_step)
    rest_image = find_rest_image(recording, n_train=n_train, rest_frames=config.rest_frames)
    dimension = visibility.estimate_intrinsic_dimension(
        q[:n_train], frames=config.dimension_frames, neighbours=config.dimension_neighbours, seed=seed
    )
    return Chart(
        mean=white.mean,
        whiten=white.whiten,
        unwhiten=white.unwhiten,
        metric=visible.metric,
        metric_scale=visible.scale,
        latents=q,
        inputs=np.asarray(recording.inputs, dtype=np.float64),
        time_s=np.asarray(recording.time_s, dtype=np.float64),
        rest=refine(rest_image, white.to_whitened(encode_frames(autoencoder, rest_image)))[0],
        n_train=n_train,
        segments=tuple((int(a), int(b)) for a, b in recording.segments),
        smoothing_frames=config.smoothing_frames,
        condition=visible.condition,
        intrinsic_dimension=dimension,
        refinement_steps=config.refinement_steps,
        visibility_step=config.visibility_step,
    )


def decode_whitened(autoencoder: Autoencoder, white: Whitening, q: Latents) -> Images:
    """Draw whitened latents."""
    raw = torch.from_numpy(white.mean) + q @ torch.from_numpy(white.unwhiten)
    with torch.no_grad():
        return autoencoder.decode(raw.to(next(autoencoder.parameters()))).cpu()


def refine_whitened(
    autoencoder: Autoencoder, white: Whitening, frames: Frames, q: Series, *, steps: int, difference: float
) -> Series:
    """Refine the whitened latents ``q`` of frames in chunks of bounded size, see `refine_latents`."""
    if not steps:
        return q
    decode, parts = partial(decode_whitened, autoencoder, white), []
    for a in range(0, len(q), CHUNK):
        images, part = to_images(np.asarray(frames[a : a + CHUNK])), torch.from_numpy(q[a : a + CHUNK])
        parts.append(refine_latents(decode, images, part, steps=steps, difference=difference))
    return torch.cat(parts).numpy() if parts else q


def save_chart(path: Path | str, chart: Chart, header: Mapping[str, Any]) -> None:
    """Write a chart; ``header`` says how it was made."""
    settings = {name: getattr(chart, name) for name in SETTINGS}
    tensors = {name: getattr(chart, name) for name in ARRAYS}
    save_artifact(path, tensors, {**header, "kind": KIND, "schema": SCHEMA, "chart": settings})


def load_chart(path: Path | str) -> tuple[Chart, dict[str, Any]]:
    """Read a chart and its header.

    Raises:
        FileNotFoundError: there is no file at ``path``.
        ValueError: the file is no chart, or lacks a setting.
    """
    tensors, header = load_artifact(path, kind=KIND, schema=SCHEMA)
    require_settings(path, header, header["chart"], SETTINGS)
    settings: dict[str, Any] = {name: tensors[name] for name in ARRAYS} | header["chart"]
    settings["segments"] = tuple((int(a), int(b)) for a, b in settings["segments"])
    return Chart(**settings), header


SAMPLE = 256  # maximum number of frames, evenly spaced over the clip
LARGEST_SHARE = 0.5  # of the variance over time that a reconstruction may leave unexplained


def require_trained_autoencoder(autoencoder: Autoencoder, frames: Frames) -> None:
    """Compare reconstructions of some frames with their mean, to reject an untrained autoencoder early.

    Raises:
        ValueError: more than half of the variance over time remains; the latents then hold little motion.
    """
    at = np.unique(np.linspace(0, len(frames) - 1, SAMPLE).astype(int))
    seen = np.asarray(frames[at])
    images = to_images(seen).double().numpy()
    drawn = decode_latents(autoencoder, encode_frames(autoencoder, seen))
    error, variance = float(np.square(drawn - images).mean()), float(images.var(0).mean())
    if error > LARGEST_SHARE * variance:
        raise ValueError(
            "stage 1 learned nothing to build on: it draws the training frames with a mean squared error of "
            f"{error:.2e}, and their mean alone would err by {variance:.2e}. Look at reconstruction.png, "
            "then raise stage1.steps, lower system.encoder_rate or take another seed"
        )
