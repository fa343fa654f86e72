"""What the rollout figure shows, computed: one long forecast and its last image."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64
from scipy.ndimage import gaussian_filter
from scipy.ndimage import shift as translate
from skimage.registration import phase_cross_correlation

from lagsplat.chart.chart import Chart
from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.evaluate import integrator, recorded, renderer
from lagsplat.evaluate.floor import image_errors
from lagsplat.evaluate.protocol import HeldOut, held_out, initial_states, pin_diverged
from lagsplat.io.recording import Recording
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.stage2.lagrangian import Lagrangian

RENDER_PX = 256
INSET = 0.28
UPSAMPLING = 50
ALIGNMENTS = 5
Picture = Float[np.ndarray, "H W 3"]


@dataclass(frozen=True)
class Inset:
    """Window (row, column, side in render pixels) and the shift (down, right) of the prediction in it."""

    row: int
    column: int
    side: int
    shift_px: tuple[float, float]


@dataclass(frozen=True)
class LongRollout:
    """One rollout of the learned dynamics, never re-anchored, and its last state as images.

    ``lost_s`` is when it diverged, or None. Renders are at ``scale`` times the recorded resolution; the mean
    squared errors are at the recorded one, the floor's from unsmoothed latents.
    """

    time_s: Float64[np.ndarray, " N"]
    encoded: Float64[np.ndarray, "N d"]
    predicted: Float64[np.ndarray, "N d"]
    inputs: Float64[np.ndarray, "N n_u"]
    input_units: tuple[str, ...]
    metric: Float64[np.ndarray, "d d"]
    recorded: Picture
    at_encoded: Picture
    at_predicted: Picture
    scale: float
    floor_mse: float
    predicted_mse: float
    lost_s: float | None
    inset: Inset


def roll_out(
    autoencoder: Autoencoder,
    chart: Chart,
    lagrangian: Lagrangian,
    recording: Recording,
    config: EvaluateConfig,
    *,
    duration_s: float = 30.0,
) -> LongRollout:
    """Roll out from the first scored frame of the longest held-out clip, for at most ``duration_s``.

    Source: paper, Reading the rollout figures.
    """
    held = held_out(chart, config)
    start, states = _longest(held, round(duration_s / held.dt_s) + 1)
    q0, v0 = initial_states(held, np.array([start]))
    time_s, steps_s = held.clock.instants_s(start, states), held.clock.steps_s(np.array([start]), states)
    rollouts = integrator(lagrangian)(q0, v0, held.forcing[None, start : start + states], steps_s)
    pinned, gone = pin_diverged(rollouts, bound=config.divergence_factor * held.reach)
    last = start + states - 1
    scale = RENDER_PX / max(recording.height, recording.width)
    size = {"height": round(scale * recording.height), "width": round(scale * recording.width)}
    ends = np.stack([held.latents[last], pinned[0, -1]])
    sharp = np.moveaxis(np.clip(renderer(autoencoder, chart, **size)(ends), 0.0, 1.0), 1, 3)
    real = recorded(recording, chart)(np.array([last]))
    plain = renderer(autoencoder, chart)(ends)
    picture = np.moveaxis(real[0], 0, 2)
    return LongRollout(
        time_s=time_s,
        encoded=held.encoded[start : start + states],
        predicted=np.where(gone[0][:, None], np.nan, rollouts[0]),
        inputs=held.inputs[start : start + states],
        input_units=tuple(dict.fromkeys(recording.input_units)),
        metric=held.metric,
        recorded=picture,
        at_encoded=sharp[0],
        at_predicted=sharp[1],
        scale=scale,
        floor_mse=float(image_errors(plain[:1], real)[0]),
        predicted_mse=float(image_errors(plain[1:], real)[0]),
        lost_s=float(time_s[np.argmax(gone[0])]) if gone.any() else None,
        inset=choose_inset(sharp[0], sharp[1]),
    )


def _longest(held: HeldOut, states: int) -> tuple[int, int]:
    """First frame and length of the rollout."""
    start, stop = max(held.clips, key=lambda clip: clip[1] - clip[0])
    return start, min(states, stop - start)


def choose_inset(at_encoded: Picture, at_predicted: Picture) -> Inset:
    """The window where the two renders differ most; the autoencoder's own error is in both.

    The shift is that of the prediction against the encoding within the window, by phase correlation with
    sub-pixel upsampling, in render pixels.
    """
    height, width = at_encoded.shape[:2]
    side = max(round(INSET * min(height, width)), 8)
    moved = gaussian_filter(np.abs(at_predicted - at_encoded).mean(axis=2), side / 4)
    half = side // 2
    inner = moved[half : height - side + half + 1, half : width - side + half + 1]
    row, column = np.unravel_index(int(np.argmax(inner)), inner.shape)
    window = (slice(row, row + side), slice(column, column + side))
    shift = measured_shift(at_encoded[window].mean(axis=2), at_predicted[window].mean(axis=2))
    return Inset(int(row), int(column), side, shift)


def measured_shift(
    reference: Float[np.ndarray, "h w"], moved: Float[np.ndarray, "h w"]
) -> tuple[float, float]:
    """How far (down, right) ``moved`` lies from ``reference``, in pixels; zero without any structure.

    The taper that hides the window's edges also pulls the estimate towards zero, so ``moved`` is shifted back
    by what was found and the rest is measured again.
    """
    taper = np.outer(np.hanning(reference.shape[0]), np.hanning(reference.shape[1]))
    first = (reference - reference.mean()) * taper
    total = np.zeros(2)
    for _ in range(ALIGNMENTS):
        back = translate(moved, -total, order=1, mode="nearest")
        second = (back - back.mean()) * taper
        if min(np.ptp(first), np.ptp(second)) < 1e-6:
            return 0.0, 0.0
        step, _, _ = phase_cross_correlation(first, second, upsample_factor=UPSAMPLING, normalization=None)
        total = total - step
    return float(total[0]), float(total[1])
