"""One long forecast from a single initial state, and its last image, for the rollout figure."""

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
from lagsplat.evaluate.evaluate import make_integrator, make_picture_reader
from lagsplat.evaluate.forecast import image_errors, state_errors, state_spread
from lagsplat.evaluate.free_motion import compare_frequency, cut_free_windows, measure_natural_period
from lagsplat.evaluate.protocol import EvaluationSeries, list_series, pin_diverged, roll_out, select_held_out
from lagsplat.io.recording.recording import Recording
from lagsplat.stage1.autoencoder import Autoencoder, decode_latents
from lagsplat.stage2.lagrangian import Lagrangian

INSET_SHARE = 0.28  # of the smaller side of the render
UPSAMPLING = 50  # of the phase correlation: shifts to 1/50 pixel
N_ALIGNMENTS = 5  # the taper biases each estimate towards zero
RgbImage = Float[np.ndarray, "H W 3"]
MIN_RENDER_PX = 256  # larger side of a render


@dataclass(frozen=True)
class FineDecoder:
    """A decoder of higher resolution over the same chart, and the recording it was fitted to."""

    decoder: Autoencoder
    recording: Recording


@dataclass(frozen=True)
class Inset:
    """Window (row, column, side in render pixels) and the prediction error in it.

    ``shift_px`` (down, right) is the prediction's shift against the encoding, in render pixels. ``ratio`` is
    the mean absolute difference of the two renders over that of the encoded state's render and the recording.
    """

    row: int
    column: int
    side: int
    shift_px: tuple[float, float]
    ratio: float


class LastImages(NamedTuple):
    """One frame: recorded, and rendered at its encoded and at its predicted state.

    Renders are at ``scale`` times the resolution of the encoded images; the mean squared errors are at the
    resolution of ``recorded``, the floor's from unsmoothed latents.
    """

    recorded: Float[np.ndarray, "h w 3"]
    at_encoded: RgbImage
    at_predicted: RgbImage
    scale: float
    floor_mse: float
    predicted_mse: float
    inset: Inset


@dataclass(frozen=True)
class LongRollout:
    """One rollout of the learned dynamics and its last state as images.

    ``held_s`` is when the held-out part begins, or None where all of it is held out; ``lost_s`` is when the
    rollout diverged, or None. ``nrmse`` is the latent error over the window and ``held_nrmse`` over its
    held-out end.
    """

    time_s: Float64[np.ndarray, " N"]
    encoded: Float64[np.ndarray, "N d"]
    predicted: Float64[np.ndarray, "N d"]
    inputs: Float64[np.ndarray, "N n_u"]
    input_names: tuple[str, ...]
    input_units: tuple[str, ...]
    metric: Float64[np.ndarray, "d d"]
    nrmse: float
    held_nrmse: float
    period_s: float | None
    held_s: float | None
    lost_s: float | None
    images: LastImages


@dataclass(frozen=True)
class FigureWindow:
    """Frames ``start`` to ``stop`` of ``series``, whose first frame is frame ``offset`` of the recording.

    ``boundary`` is the first held-out frame, counted from the start of the window; 0 if all are held out.
    """

    series: EvaluationSeries
    offset: int
    start: int
    stop: int
    boundary: int


def compute_long_rollout(
    autoencoder: Autoencoder,
    chart: Chart,
    lagrangian: Lagrangian,
    recording: Recording,
    config: EvaluateConfig,
    *,
    fine: FineDecoder | None = None,
) -> LongRollout:
    """Roll out over the window that ``config.figure`` asks for, and render its last state.

    A ``fine`` decoder, where one was fitted, renders in the place of the autoencoder.

    Raises:
        ValueError: no such window, or ``fine`` is of another recording.

    Source: paper, Reading the rollout figures.
    """
    window = choose_figure_window(chart, config)
    series, frames = window.series, slice(window.start, window.stop)
    integrate, n_states = make_integrator(lagrangian), window.stop - window.start
    rollouts = roll_out(series, integrate, np.array([window.start]), n_states)
    time_s = series.clock.instants_s(window.start, n_states)
    held = select_held_out(chart, config)
    reach = max(held.reach, series.reach)
    pinned, diverged = pin_diverged(rollouts, bound=config.divergence_factor * reach)
    error = state_errors(held, pinned[0], diverged[0], series.latents[frames]) / state_spread(held)
    last = window.offset + window.stop - 1  # counted from the start of the recording
    ends = np.stack([chart.latents[last], pinned[0, -1]])
    source = fine or FineDecoder(autoencoder, recording)
    if source.recording.n_frames != recording.n_frames:
        raise ValueError(
            f"the finer recording has {source.recording.n_frames} frames and the recording "
            f"{recording.n_frames}; read both in the same way"
        )
    frequency = compare_frequency(*cut_free_windows(held, integrate, config), dt_s=held.dt_s)
    return LongRollout(
        time_s=time_s,
        encoded=series.latents[frames],
        predicted=np.where(diverged[0][:, None], np.nan, rollouts[0]),
        inputs=series.inputs[frames],
        input_names=recording.input_names,
        input_units=recording.input_units,
        metric=series.metric,
        nrmse=float(np.sqrt(error.mean())),
        held_nrmse=float(np.sqrt(error[window.boundary :].mean())),
        period_s=measure_natural_period(frequency, config),
        held_s=float(time_s[window.boundary]) if window.boundary else None,
        lost_s=float(time_s[np.argmax(diverged[0])]) if diverged.any() else None,
        images=_render_last(source, chart, ends, frame=last, encoded_height=recording.height),
    )


def choose_figure_window(chart: Chart, config: EvaluateConfig) -> FigureWindow:
    """Choose the window that ``config.figure`` asks for, of at most its duration and within one clip.

    Raises:
        ValueError: ``boundary``, and no clip holds both training and held-out frames.

    Source: paper, the figures of the rainbow rocker (boundary) and of the hanging bag (held_out).
    """
    held = select_held_out(chart, config)
    most = round(config.figure.duration_s / chart.dt_s) + 1
    if config.figure.start == "held_out":
        start, stop = held.longest
        return FigureWindow(held, chart.n_train, start, min(start + most, stop), 0)
    series = list_series(chart, chart.whole, velocity=config.velocity)
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
    return FigureWindow(series, 0, start, min(start + most, end), chart.n_train - start)


def _render_last(
    source: FineDecoder, chart: Chart, ends: np.ndarray, *, frame: int, encoded_height: int
) -> LastImages:
    decoder, recording = source.decoder, source.recording
    height, width = recording.height, recording.width
    scale = max(MIN_RENDER_PX / max(height, width), 1.0)
    size = {"height": round(scale * height), "width": round(scale * width)}
    fine = np.moveaxis(np.clip(decode_latents(decoder, chart.to_raw(ends), **size), 0.0, 1.0), 1, 3)
    renders = decode_latents(decoder, chart.to_raw(ends))
    recorded = make_picture_reader(recording, first=0)(np.array([frame]))
    error = np.abs(np.clip(renders[0], 0.0, 1.0) - recorded[0]).mean(axis=0)
    floor_mse, predicted_mse = (float(image_errors(render[None], recorded)[0]) for render in renders)
    return LastImages(
        recorded=np.moveaxis(recorded[0], 0, 2),
        at_encoded=fine[0],
        at_predicted=fine[1],
        scale=len(fine[0]) / encoded_height,
        floor_mse=floor_mse,
        predicted_mse=predicted_mse,
        inset=choose_inset(fine[0], fine[1], error),
    )


def choose_inset(
    at_encoded: RgbImage, at_predicted: RgbImage, reconstruction_error: Float[np.ndarray, "h w"]
) -> Inset:
    """Choose the window where the two renders differ most, less the autoencoder's own error there.

    Where they nowhere differ by more than that error, the error is not subtracted: it would choose the
    background. ``reconstruction_error`` is the mean absolute error of the render at the encoded state, at
    the recorded resolution. Both are averaged by the same Gaussian before they are subtracted.

    Source: paper, Reading the rollout figures.
    """
    height, width = at_encoded.shape[:2]
    side = max(round(INSET_SHARE * min(height, width)), 8)
    moved = np.abs(at_predicted - at_encoded).mean(axis=2)
    error = resize(reconstruction_error, (height, width), order=1, mode="edge", anti_aliasing=False)
    half = side // 2
    inside = (slice(half, height - side + half + 1), slice(half, width - side + half + 1))
    excess, whole = (gaussian_filter(each, side / 4)[inside] for each in (moved - error, moved))
    inner = excess if excess.max() > 0.0 else whole
    row, column = np.unravel_index(int(np.argmax(inner)), inner.shape)
    window = (slice(row, row + side), slice(column, column + side))
    shift = estimate_shift(at_encoded[window].mean(axis=2), at_predicted[window].mean(axis=2))
    ratio = float(moved[window].mean() / max(error[window].mean(), 1e-12))
    return Inset(int(row), int(column), side, shift, ratio)


def estimate_shift(
    reference: Float[np.ndarray, "h w"], moved: Float[np.ndarray, "h w"]
) -> tuple[float, float]:
    """Estimate the shift (down, right) of ``moved`` against ``reference`` in pixels; zero without structure.

    The taper that hides the window's edges biases the estimate towards zero, so ``moved`` is shifted back by
    the estimate and the remainder is measured again.
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
