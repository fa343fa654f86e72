"""Extrapolation of models that predict images without states: the frozen encoder reads their states."""

from dataclasses import replace
from typing import Any

import numpy as np
from jaxtyping import Float32

from lagsplat.array_types import Frames
from lagsplat.baselines.keypoints.model import Forecaster, continue_path, draw_path, fit_path
from lagsplat.evaluate.extrapolation.forecast import (
    Draw,
    Predictor,
    score_extrapolation,
    score_held_out_psnr,
    to_decibels,
)
from lagsplat.evaluate.extrapolation.scene import Scene, StateReading

AT_ONCE = 256  # images rendered and encoded at once: bounds memory, not results


def make_image_predictor(
    scene: Scene, fitted: Float32[np.ndarray, "train 3 H W"], show: Draw, *, between_frames: bool
) -> Predictor:
    """A model of images: ``fitted`` reconstructs the clip's training frames, ``show`` predicts."""

    def draw(ahead: np.ndarray) -> np.ndarray:
        images = show(np.maximum(ahead, 0.0))
        for i in np.flatnonzero(ahead < 0):
            images[i] = fitted[max(round(ahead[i]) - 1, -len(fitted))]
        return images

    def states(first: int, stop: int) -> tuple[np.ndarray, list[StateReading]]:
        instants = np.arange(first, stop, dtype=np.float64)
        parts = [scene.read(show(instants[i : i + AT_ONCE])) for i in range(0, len(instants), AT_ONCE)]
        return np.concatenate([part.states for part in parts]), parts

    filmed = [scene.to_states(fitted), scene.to_states(draw(scene.clip.ahead))]
    return Predictor(np.concatenate(filmed), draw, states, between_frames)


def extrapolate_forecaster(scene: Scene, forecaster: Forecaster) -> dict[str, Any]:
    """The measures of `score_extrapolation` for a key-point forecaster, and measures of its networks.

    ``own`` holds the PSNR of its reconstructed training frames and, by its motion network at times it was not
    trained on, of the held-out frames (``in_time``), and the mean step of its key points between frames.

    Raises:
        ValueError: the forecaster was trained on other frames.
    """
    clip, config, of = scene.clip, scene.config, forecaster.architecture
    height, width = scene.autoencoder.height, scene.autoencoder.width
    if (of.frames, of.height, of.width) != (clip.n_train, height, width):
        raise ValueError(
            f"the forecaster was trained on {of.frames} frames of {of.height} x {of.width}, the clip has "
            f"{clip.n_train} of {height} x {width}; train it on this recording"
        )
    instants = np.arange(clip.n_train, dtype=np.float64)
    train = fit_path(forecaster, instants)
    fitted = draw_path(forecaster, train, instants)
    last = round(config.horizon_s / clip.dt_s) + int(np.ceil(config.shift_frames)) + 1
    path = continue_path(forecaster, last)

    def show(ahead: np.ndarray) -> np.ndarray:
        return draw_path(forecaster, path, ahead)

    predictor = make_image_predictor(scene, fitted, show, between_frames=True)
    in_time = fit_path(forecaster, clip.n_train - 1 + clip.ahead)
    shown = draw_path(forecaster, in_time, np.arange(len(clip.ahead), dtype=np.float64))
    recorded = scene.pictures(np.arange(clip.start, clip.boundary))
    held_out = scene.pictures(np.arange(clip.boundary, clip.stop))
    error = ((fitted - recorded) ** 2).mean(axis=(1, 2, 3)).astype(np.float64)
    own = {
        "fitted_psnr": float(to_decibels(error).mean()),
        "in_time": score_held_out_psnr(lambda _: shown, held_out, clip.ahead),
        "key_point_motion": float(np.linalg.norm(np.diff(train.places, axis=0), axis=2).mean()),
    }
    return score_extrapolation(predictor, scene) | {"own": own}


def extrapolate_frames(scene: Scene, frames: Frames) -> dict[str, Any]:
    """The measures of `score_extrapolation` for ``frames`` (N,H,W,3) that another program predicted.

    The first is the first held-out frame. They hold nothing of the training part, so no oscillation is
    compared over the whole clip: see ``held_out``. If they end before the horizon, no amplitude at the
    horizon is given.

    Raises:
        ValueError: fewer frames than are held out, or frames of another size.
    """
    clip, config = scene.clip, scene.config
    held = clip.stop - clip.boundary
    if len(frames) < held:
        raise ValueError(
            f"{len(frames)} predicted frames, but {held} are held out; let the tool predict as many"
        )

    def show(ahead: np.ndarray) -> np.ndarray:
        chosen = np.clip(np.round(ahead).astype(np.int64) - 1, 0, len(frames) - 1)
        return np.moveaxis(frames[chosen], 3, 1).astype(np.float32) / np.float32(255.0)

    reached_s = len(frames) * clip.dt_s
    shown_s = min(config.shown_s, reached_s)
    within = replace(config, shown_s=shown_s, horizon_s=max(min(config.horizon_s, reached_s), shown_s))
    shortened = replace(scene, config=within)
    size = (scene.autoencoder.height, scene.autoencoder.width)
    unknown = np.full((clip.n_train, 3, *size), np.nan, dtype=np.float32)
    predictor = make_image_predictor(shortened, unknown, show, between_frames=False)
    result = score_extrapolation(predictor, shortened)
    if within.horizon_s < config.horizon_s:
        why = f"{reached_s:.4g} s were predicted, not the {config.horizon_s:.4g} s of the horizon"
        result |= {"left": None, "reason": result["reason"] or why}
        if shown_s < config.shown_s:
            result["left_shown"] = None
    return result
