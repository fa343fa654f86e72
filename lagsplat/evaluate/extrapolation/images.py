"""Extrapolation of models that predict images without states: the frozen encoder reads their states."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64

from lagsplat.array_types import Frames
from lagsplat.baselines.keypoints.model import Forecaster, KeyPointPath, continue_path, draw_path, fit_path
from lagsplat.chart.chart import Chart
from lagsplat.evaluate.config import ExtrapolationConfig
from lagsplat.evaluate.extrapolation.forecast import (
    open_scene,
    score_extrapolation,
    score_held_out_psnr,
    to_decibels,
)
from lagsplat.evaluate.extrapolation.oscillation import KnownStates, StateReading, read_states
from lagsplat.evaluate.forecast import BoundaryClip
from lagsplat.io.recording.recording import Recording
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.stage2.lagrangian import Lagrangian

AT_ONCE = 256  # images rendered and encoded at once: bounds memory, not results


@dataclass(frozen=True)
class ImagePredictor:
    """A model of images: ``fitted`` reconstructs the clip's training frames, ``show`` predicts.

    ``show`` takes instants in frames since the last training frame.
    """

    known: KnownStates
    config: ExtrapolationConfig
    crossing: BoundaryClip
    fitted: Float32[np.ndarray, "train 3 H W"]
    show: Callable[[np.ndarray], np.ndarray]
    between_frames: bool

    def filmed(self) -> Float64[np.ndarray, "T d"]:
        """States encoded from its reconstructed training frames and from its prediction."""
        seen = [self.known.to_states(self.fitted), self.known.to_states(self.draw(self.crossing.ahead))]
        return np.concatenate(seen)

    def draw(self, ahead: np.ndarray) -> np.ndarray:
        """Its predicted images; before the last training frame, the reconstructed ones."""
        images = self.show(np.maximum(ahead, 0.0))
        for i in np.flatnonzero(ahead < 0):
            images[i] = self.fitted[max(round(ahead[i]) - 1, -len(self.fitted))]
        return images

    def states(self, first: int, stop: int) -> tuple[Float64[np.ndarray, "N d"], StateReading | None]:
        """States encoded from its predicted images, and whether these are in range."""
        parts = [
            read_states(
                self.known, self.show(np.arange(a, min(a + AT_ONCE, stop), dtype=np.float64)), self.config
            )
            for a in range(first, stop, AT_ONCE)
        ]
        reading = StateReading(
            *(
                np.concatenate([getattr(part, name) for part in parts])
                for name in ("states", "error", "distance", "inside")
            )
        )
        return reading.states, reading


def extrapolate_forecaster(
    autoencoder: Autoencoder,
    chart: Chart,
    lagrangian: Lagrangian,
    forecaster: Forecaster,
    recording: Recording,
    config: ExtrapolationConfig,
) -> dict[str, Any]:
    """The measures of `score_extrapolation` for a key-point forecaster, and measures of its networks.

    ``own`` holds the PSNR of its reconstructed training frames, of the held-out frames by its motion network
    at times it was not trained on (``in_time``), and the one-step error of the graph network over the motion
    from frame to frame.

    Raises:
        ValueError: the forecaster was trained on other frames, or as `open_scene`.
    """
    crossing, known, pictures = open_scene(autoencoder, chart, recording)
    of = forecaster.architecture
    if (of.frames, of.height, of.width) != (crossing.n_train, recording.height, recording.width):
        raise ValueError(
            f"the forecaster was trained on {of.frames} frames of {of.height} x {of.width}, the clip has "
            f"{crossing.n_train} of {recording.height} x {recording.width}; train it on this recording"
        )
    train = fit_path(forecaster, np.arange(crossing.n_train, dtype=np.float64))
    fitted = draw_path(forecaster, train, np.arange(crossing.n_train, dtype=np.float64))
    last = round(config.horizon_s / crossing.dt_s) + int(np.ceil(config.shift_frames)) + 1
    path = continue_path(forecaster, last)
    predictor = ImagePredictor(
        known, config, crossing, fitted, lambda at: draw_path(forecaster, path, at), between_frames=True
    )
    found = score_extrapolation(predictor, crossing, known, pictures, config, lagrangian)
    recorded = pictures(np.arange(crossing.start, crossing.boundary))
    return found | {"own": _own(forecaster, crossing, recorded, fitted, train, pictures)}


def _own(
    forecaster: Forecaster,
    crossing: BoundaryClip,
    recorded: np.ndarray,
    fitted: np.ndarray,
    train: KeyPointPath,
    pictures: Callable[[np.ndarray], np.ndarray],
) -> dict[str, Any]:
    from_first = crossing.n_train - 1 + crossing.ahead
    asked = fit_path(forecaster, from_first)
    held = pictures(np.arange(crossing.boundary, crossing.stop))
    shown = draw_path(forecaster, asked, np.arange(len(from_first), dtype=np.float64))
    error = ((fitted - recorded) ** 2).mean(axis=(1, 2, 3)).astype(np.float64)
    return {
        "fitted_psnr": float(to_decibels(error).mean()),
        "in_time": score_held_out_psnr(lambda _: shown, held, crossing.ahead),
        "key_point_motion": float(np.linalg.norm(np.diff(train.places, axis=0), axis=2).mean()),
    }


def extrapolate_frames(
    autoencoder: Autoencoder,
    chart: Chart,
    lagrangian: Lagrangian,
    frames: Frames,
    recording: Recording,
    config: ExtrapolationConfig,
) -> dict[str, Any]:
    """The measures of `score_extrapolation` for ``frames`` (N,H,W,3) that another program predicted.

    The first is the first held-out frame. They hold nothing of the training part, so no oscillation is
    compared over the whole clip: see ``held_out``. If they end before the horizon, no amplitude at the
    horizon is given.

    Raises:
        ValueError: fewer frames than are held out, or frames of another size; or as `open_scene`.
    """
    crossing, known, pictures = open_scene(autoencoder, chart, recording)
    held = crossing.stop - crossing.boundary
    if len(frames) < held:
        raise ValueError(
            f"{len(frames)} predicted frames, but {held} are held out; let the tool predict as many"
        )

    def show(ahead: np.ndarray) -> np.ndarray:
        chosen = np.clip(np.round(ahead).astype(np.int64) - 1, 0, len(frames) - 1)
        return np.moveaxis(frames[chosen], 3, 1).astype(np.float32) / np.float32(255.0)

    reached_s = len(frames) * crossing.dt_s
    shown_s = min(config.shown_s, reached_s)
    within = replace(config, shown_s=shown_s, horizon_s=max(min(config.horizon_s, reached_s), shown_s))
    unknown = np.full((crossing.n_train, 3, recording.height, recording.width), np.nan, dtype=np.float32)
    predictor = ImagePredictor(known, within, crossing, unknown, show, between_frames=False)
    found = score_extrapolation(predictor, crossing, known, pictures, within, lagrangian)
    if within.horizon_s < config.horizon_s:
        why = f"{reached_s:.4g} s were predicted, not the {config.horizon_s:.4g} s of the horizon"
        found |= {"left": None, "reason": found["reason"] or why}
        if shown_s < config.shown_s:
            found["left_shown"] = None
    return found
