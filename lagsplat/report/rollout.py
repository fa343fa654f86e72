"""What the rollout figure shows, computed: one long forecast and its last image."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from lagsplat.chart.chart import Chart
from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.evaluate import integrator, renderer
from lagsplat.evaluate.floor import image_errors
from lagsplat.evaluate.free import free_windows
from lagsplat.evaluate.frequency import compare_frequency, natural_period
from lagsplat.evaluate.latent import spread, state_errors
from lagsplat.evaluate.protocol import held_out, initial_states, pin_diverged
from lagsplat.io.recording import Recording
from lagsplat.report.inset import Inset, Picture, choose_inset
from lagsplat.report.stretch import choose_stretch, held_from
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.stage2.lagrangian import Lagrangian

RENDER_PX = 256


@dataclass(frozen=True)
class Fine:
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
    recorded: Picture
    at_encoded: Picture
    at_predicted: Picture
    scale: float
    floor_mse: float
    predicted_mse: float
    inset: Inset


def roll_out(
    autoencoder: Autoencoder,
    chart: Chart,
    lagrangian: Lagrangian,
    recording: Recording,
    config: EvaluateConfig,
    *,
    fine: Fine | None = None,
) -> LongRollout:
    """Roll out over the stretch that ``config.figure`` asks for; ``fine`` draws it where one was fitted.

    Raises:
        ValueError: no such stretch, or ``fine`` is of another recording.

    Source: paper, Reading the rollout figures.
    """
    stretch = choose_stretch(chart, config)
    series, frames = stretch.series, stretch.frames
    integrate, start = integrator(lagrangian), np.array([stretch.start])
    n_states = stretch.stop - stretch.start
    q0, v0 = initial_states(series, start)
    time_s = series.clock.instants_s(stretch.start, n_states)
    rollouts = integrate(q0, v0, series.forcing[None, frames], series.clock.steps_s(start, n_states))
    held = held_out(chart, config)
    reach = max(held.reach, series.reach)
    pinned, gone = pin_diverged(rollouts, bound=config.divergence_factor * reach)
    error = state_errors(held, pinned[0], gone[0], series.encoded[frames]) / spread(held)
    first = held_from(stretch, chart) or 0
    ends = np.stack([chart.latents[stretch.last], pinned[0, -1]])
    shown = fine or Fine(autoencoder, recording)
    if shown.recording.n_frames != recording.n_frames:
        raise ValueError(
            f"the finer recording has {shown.recording.n_frames} frames and the recording "
            f"{recording.n_frames}; read both in the same way"
        )
    images = _last_images(shown, chart, ends, frame=stretch.last)
    pixels = images.at_encoded.shape[0] / recording.height
    frequency = compare_frequency(*free_windows(held, integrate, config), dt_s=held.dt_s)
    return LongRollout(
        time_s=time_s,
        encoded=series.encoded[frames],
        predicted=np.where(gone[0][:, None], np.nan, rollouts[0]),
        inputs=series.inputs[frames],
        input_units=tuple(dict.fromkeys(recording.input_units)),
        metric=series.metric,
        nrmse=float(np.sqrt(error.mean())),
        held_nrmse=float(np.sqrt(error[first:].mean())),
        period_s=natural_period(frequency, config),
        held_s=float(time_s[first]) if first else None,
        lost_s=float(time_s[np.argmax(gone[0])]) if gone.any() else None,
        scale=pixels,
        **images._asdict(),
    )


class _Images(NamedTuple):
    recorded: Picture
    at_encoded: Picture
    at_predicted: Picture
    floor_mse: float
    predicted_mse: float
    inset: Inset


def _last_images(shown: Fine, chart: Chart, ends: np.ndarray, *, frame: int) -> _Images:
    """The images of one frame: recorded, and rendered at its encoded and at its predicted state."""
    decoder, recording = shown.decoder, shown.recording
    height, width = recording.height, recording.width
    scale = max(RENDER_PX / max(height, width), 1.0)
    size = {"height": round(scale * height), "width": round(scale * width)}
    fine = np.moveaxis(np.clip(renderer(decoder, chart, **size)(ends), 0.0, 1.0), 1, 3)
    plain = renderer(decoder, chart)(ends)
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
