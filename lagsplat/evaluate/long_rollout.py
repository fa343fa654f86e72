"""Where a predicted render differs from the encoded one by more than reconstruction, and by how far.

What the rollout figure shows, computed: one long forecast and its last image.

Which stretch of a recording the rollout figure shows.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float64
from scipy.ndimage import gaussian_filter
from scipy.ndimage import shift as translate
from skimage.registration import phase_cross_correlation
from skimage.transform import resize

from lagsplat.chart.chart import Chart
from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.evaluate import make_integrator, make_renderer
from lagsplat.evaluate.forecast import image_errors
from lagsplat.evaluate.free_motion import compare_frequency, cut_free_windows, measure_natural_period
from lagsplat.evaluate.latent import state_errors, state_spread
from lagsplat.evaluate.protocol import HeldOut, initial_states, list_series, pin_diverged, select_held_out
from lagsplat.io.recording.recording import Recording
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.stage2.lagrangian import Lagrangian

INSET_SHARE = 0.28
UPSAMPLING = 50
N_ALIGNMENTS = 5
RgbImage = Float[np.ndarray, "H W 3"]


@dataclass(frozen=True)
class Inset:
    """Window (row, column, side in render pixels) and what the prediction does in it.

    ``shift_px`` (down, right) is its shift against the encoding, in render pixels. ``ratio`` is the mean
    absolute difference of the two renders over that of the render at the encoded state and the recording.
    """

    row: int
    column: int
    side: int
    shift_px: tuple[float, float]
    ratio: float


def choose_inset(
    at_encoded: RgbImage, at_predicted: RgbImage, reconstruction_error: Float[np.ndarray, "h w"]
) -> Inset:
    """The window where the two renders differ most in excess of what the autoencoder gets wrong there.

    ``reconstruction_error`` is the mean absolute error of the render at the encoded state, at the recorded
    resolution. Both are averaged under the window, by the same Gaussian, before one is taken from the other.

    Source: paper, Reading the rollout figures.
    """
    height, width = at_encoded.shape[:2]
    side = max(round(INSET_SHARE * min(height, width)), 8)
    moved = np.abs(at_predicted - at_encoded).mean(axis=2)
    wrong = resize(reconstruction_error, (height, width), order=1, mode="edge", anti_aliasing=False)
    excess = gaussian_filter(moved - wrong, side / 4)
    half = side // 2
    inner = excess[half : height - side + half + 1, half : width - side + half + 1]
    row, column = np.unravel_index(int(np.argmax(inner)), inner.shape)
    window = (slice(row, row + side), slice(column, column + side))
    shift = estimate_shift(at_encoded[window].mean(axis=2), at_predicted[window].mean(axis=2))
    ratio = float(moved[window].mean() / max(wrong[window].mean(), 1e-12))
    return Inset(int(row), int(column), side, shift, ratio)


def estimate_shift(
    reference: Float[np.ndarray, "h w"], moved: Float[np.ndarray, "h w"]
) -> tuple[float, float]:
    """How far (down, right) ``moved`` lies from ``reference``, in pixels; zero without any structure.

    The taper that hides the window's edges also pulls the estimate towards zero, so ``moved`` is shifted back
    by what was found and the rest is measured again.
    """
    taper = np.outer(np.hanning(reference.shape[0]), np.hanning(reference.shape[1]))
    first = (reference - reference.mean()) * taper
    total = np.zeros(2)
    for _ in range(N_ALIGNMENTS):
        back = translate(moved, -total, order=1, mode="nearest")
        second = (back - back.mean()) * taper
        if min(np.ptp(first), np.ptp(second)) < 1e-6:
            return 0.0, 0.0
        step, _, _ = phase_cross_correlation(first, second, upsample_factor=UPSAMPLING, normalization=None)
        total = total - step
    return float(total[0]), float(total[1])


MIN_RENDER_PX = 256


@dataclass(frozen=True)
class FineDecoder:
    """A finer decoder over the same chart, and the finer recording it was fitted to, frame by frame."""

    decoder: Autoencoder
    recording: Recording


@dataclass(frozen=True)
class LongRollout:
    """One rollout of the learned dynamics, never re-anchored, and its last state as images.

    ``held_s`` is when the held-out part begins, or None where all of it is; ``lost_s`` is when the rollout
    diverged, or None. ``nrmse`` is the latent error over the whole stretch and ``held_nrmse`` over its
    held-out end. Renders are at ``scale`` times the resolution that the latents were encoded at; the mean
    squared errors are at the resolution of ``recorded``, the floor's from unsmoothed latents.
    """

    time_s: Float64[np.ndarray, " N"]
    encoded: Float64[np.ndarray, "N d"]
    predicted: Float64[np.ndarray, "N d"]
    inputs: Float64[np.ndarray, "N n_u"]
    input_units: tuple[str, ...]
    metric: Float64[np.ndarray, "d d"]
    nrmse: float
    held_nrmse: float
    period_s: float | None
    held_s: float | None
    lost_s: float | None
    recorded: RgbImage
    at_encoded: RgbImage
    at_predicted: RgbImage
    scale: float
    floor_mse: float
    predicted_mse: float
    inset: Inset


def compute_long_rollout(
    autoencoder: Autoencoder,
    chart: Chart,
    lagrangian: Lagrangian,
    recording: Recording,
    config: EvaluateConfig,
    *,
    fine: FineDecoder | None = None,
) -> LongRollout:
    """Roll out over the stretch that ``config.figure`` asks for; ``fine`` draws it where one was fitted.

    Raises:
        ValueError: no such stretch, or ``fine`` is of another recording.

    Source: paper, Reading the rollout figures.
    """
    stretch = choose_figure_window(chart, config)
    series, frames = stretch.series, stretch.frames
    integrate, start = make_integrator(lagrangian), np.array([stretch.start])
    n_states = stretch.stop - stretch.start
    q0, v0 = initial_states(series, start)
    time_s = series.clock.instants_s(stretch.start, n_states)
    rollouts = integrate(q0, v0, series.forcing[None, frames], series.clock.steps_s(start, n_states))
    held = select_held_out(chart, config)
    reach = max(held.reach, series.reach)
    pinned, gone = pin_diverged(rollouts, bound=config.divergence_factor * reach)
    error = state_errors(held, pinned[0], gone[0], series.encoded[frames]) / state_spread(held)
    first = first_held_out(stretch, chart) or 0
    ends = np.stack([chart.latents[stretch.last], pinned[0, -1]])
    shown = fine or FineDecoder(autoencoder, recording)
    if shown.recording.n_frames != recording.n_frames:
        raise ValueError(
            f"the finer recording has {shown.recording.n_frames} frames and the recording "
            f"{recording.n_frames}; read both in the same way"
        )
    images = _last_images(shown, chart, ends, frame=stretch.last)
    pixels = images.at_encoded.shape[0] / recording.height
    frequency = compare_frequency(*cut_free_windows(held, integrate, config), dt_s=held.dt_s)
    return LongRollout(
        time_s=time_s,
        encoded=series.encoded[frames],
        predicted=np.where(gone[0][:, None], np.nan, rollouts[0]),
        inputs=series.inputs[frames],
        input_units=tuple(dict.fromkeys(recording.input_units)),
        metric=series.metric,
        nrmse=float(np.sqrt(error.mean())),
        held_nrmse=float(np.sqrt(error[first:].mean())),
        period_s=measure_natural_period(frequency, config),
        held_s=float(time_s[first]) if first else None,
        lost_s=float(time_s[np.argmax(gone[0])]) if gone.any() else None,
        scale=pixels,
        **images._asdict(),
    )


class _Images(NamedTuple):
    recorded: RgbImage
    at_encoded: RgbImage
    at_predicted: RgbImage
    floor_mse: float
    predicted_mse: float
    inset: Inset


def _last_images(shown: FineDecoder, chart: Chart, ends: np.ndarray, *, frame: int) -> _Images:
    """The images of one frame: recorded, and rendered at its encoded and at its predicted state."""
    decoder, recording = shown.decoder, shown.recording
    height, width = recording.height, recording.width
    scale = max(MIN_RENDER_PX / max(height, width), 1.0)
    size = {"height": round(scale * height), "width": round(scale * width)}
    fine = np.moveaxis(np.clip(make_renderer(decoder, chart, **size)(ends), 0.0, 1.0), 1, 3)
    plain = make_renderer(decoder, chart)(ends)
    picture = np.asarray(recording.frames[frame]).astype(np.float32) / np.float32(255.0)
    real = np.moveaxis(picture, 2, 0)[None]
    wrong = np.abs(np.clip(plain[0], 0.0, 1.0) - real[0]).mean(axis=0)
    return _Images(
        recorded=picture,
        at_encoded=fine[0],
        at_predicted=fine[1],
        floor_mse=float(image_errors(plain[:1], real)[0]),
        predicted_mse=float(image_errors(plain[1:], real)[0]),
        inset=choose_inset(fine[0], fine[1], wrong),
    )


@dataclass(frozen=True)
class FigureWindow:
    """Frames ``start`` to ``stop`` of ``series``, whose first frame is frame ``offset`` of the recording."""

    series: HeldOut
    offset: int
    start: int
    stop: int

    @property
    def frames(self) -> slice:
        """The stretch within the series."""
        return slice(self.start, self.stop)

    @property
    def last(self) -> int:
        """Its last frame, counted from the start of the recording."""
        return self.offset + self.stop - 1


def choose_figure_window(chart: Chart, config: EvaluateConfig) -> FigureWindow:
    """The stretch that ``config.figure`` asks for, of at most its duration and within one clip.

    Raises:
        ValueError: ``boundary``, and no clip holds both training and held-out frames.

    Source: paper, the figures of the rainbow rocker (boundary) and of the hanging bag (held_out).
    """
    held = select_held_out(chart, config)
    most = round(config.figure.duration_s / chart.dt_s) + 1
    if config.figure.start == "held_out":
        start, stop = held.longest
        return FigureWindow(held, chart.n_train, start, min(start + most, stop))
    series = list_series(chart, chart.whole, config, skip=0)
    crossing = [clip for clip in series.clips if clip[0] < chart.n_train < clip[1]]
    if not crossing:
        raise ValueError(
            "evaluate.figure.start=boundary: the held-out part begins with a new clip, and no rollout can "
            "cross into it; use held_out"
        )
    begin, end = crossing[0]
    start = max(begin, end - most)
    if start > chart.n_train - most // 4:  # the held-out end would fill the figure
        start = max(begin, chart.n_train - most // 2)
    return FigureWindow(series, 0, start, min(start + most, end))


def first_held_out(stretch: FigureWindow, chart: Chart) -> int | None:
    """First held-out frame, counted from the start of the stretch; None if all of it is held out."""
    first = chart.n_train - stretch.offset - stretch.start
    return first if first > 0 else None
