"""Forecasts that a model must beat to have learned anything, and laws that are regressed on its latents.

Each is scored as every other model is, from the same encoded states and drawn by the same decoder, except the
mean image, which is drawn as it is.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.chart.chart import Chart
from lagsplat.evaluate.aggregate import MEAN_IMAGE
from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.evaluate import make_picture_reader, require_same_run, score_latent_law
from lagsplat.evaluate.latent_regression import (
    fit_gaussian_process,
    fit_koopman_law,
    fit_linear_law,
    select_frames,
)
from lagsplat.evaluate.protocol import EvaluationSeries, Integrate, initial_states, list_series, squared_norm
from lagsplat.integer_lists import choose_evenly
from lagsplat.io.recording.recording import Recording
from lagsplat.stage1.autoencoder import Autoencoder

MOST_FRAMES = 4096  # training frames that a mean image and a search take, evenly spaced: bounds memory


def evaluate_simple_predictors(
    autoencoder: Autoencoder, chart: Chart, recording: Recording, config: EvaluateConfig
) -> dict[str, dict[str, Any]]:
    """Every score of each simple predictor on the held-out part of a recording, ready for JSON.

    Args:
        autoencoder: Whose decoder draws the forecasts.
        chart: Its latents of the recording.
        recording: Of which the first part is for training.
        config: The protocol.

    Returns:
        By the predictor's name what `lagsplat.evaluate.evaluate.score` gives. A mean image has no floor of
        its own, so its image error over two periods is divided by the decoder's.

    Raises:
        ValueError: recording, chart and autoencoder do not belong together, the training part has no clip
            of more than a few frames, or the held-out part is too short for the protocol.
    """
    require_same_run(autoencoder, chart, recording)
    train = list_series(chart, chart.train, velocity=config.velocity)
    mean = chart.train.latents.mean(axis=0)
    integrators: dict[str, Integrate] = {
        MEAN_IMAGE: lambda q0, v0, inputs, steps_s: _repeat(np.broadcast_to(mean, q0.shape), inputs),
        "Hold": lambda q0, v0, inputs, steps_s: _repeat(q0, inputs),
        "Nearest neighbour": make_neighbour_search(train),
        "Linear least squares": fit_linear_law(train),
        "Koopman least squares": fit_koopman_law(train, horizon=round(config.horizon_s / chart.dt_s)),
        "Gaussian process": fit_gaussian_process(train),
    }
    kinds = {
        "Linear least squares": "linear",
        "Koopman least squares": "linear",
        "Gaussian process": "nonlinear",
    }
    model = (autoencoder, chart, recording, config)
    scores = {}
    for name, integrate in integrators.items():
        render = draw_mean_image(recording) if name == MEAN_IMAGE else None
        kind = kinds.get(name, "none")
        scores[name] = score_latent_law(*model, integrate, dynamics=kind, render=render)
    floor = scores["Hold"]["latent"].get("floor")
    _divide_by_floor(scores[MEAN_IMAGE], floor)
    return scores


def _repeat(q: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    return np.repeat(q[:, None], inputs.shape[1], axis=1)


def draw_mean_image(recording: Recording) -> Callable[[np.ndarray], np.ndarray]:
    """A function that draws the mean of the training images for any state."""
    n_train = recording.split()[0].n_frames
    frames = choose_evenly(n_train, MOST_FRAMES)
    pictures = make_picture_reader(recording, first=0)
    total = sum(pictures(part).sum(axis=0, dtype=np.float64) for part in np.array_split(frames, len(frames)))
    mean = (total / len(frames)).astype(np.float32)
    return lambda q: np.broadcast_to(mean, (len(q), *mean.shape))


def _divide_by_floor(scores: dict[str, Any], floor: float | None) -> None:
    for key in ("ae_floor", "image_ratio"):
        scores["scores"][key] = None
    scores["intervals"]["image_ratio"] = [None, None]
    if floor is not None:
        scores["scores"]["image_ratio"] = scores["latent"]["image_mse"] / floor


def make_neighbour_search(train: EvaluationSeries) -> Integrate:
    """What followed the training frame that is nearest in state, velocity and the inputs to come.

    Distances are shares of the training part's own variance, of states and velocities in the visibility
    metric. Frames without so many frames after them are taken only where no training clip is long enough;
    then the clip's last state is kept.

    Source: forecasts by analogues, DOI 10.1175/1520-0469(1969)26<636:APARBN>2.0.CO;2.
    """
    frames = select_frames(train, ahead=1)
    frames = frames[choose_evenly(len(frames), MOST_FRAMES)]
    q, v = initial_states(train, frames)
    last = np.array([next(stop for start, stop in train.segments if start <= at < stop) for at in frames]) - 1
    spread_q, spread_v = (_spread(series, train.metric) for series in (q, v))
    spread_u = float(train.forcing.var(axis=0).sum()) or 1.0

    def integrate(q0: np.ndarray, v0: np.ndarray, inputs: np.ndarray, steps_s: Any) -> np.ndarray:
        del steps_s  # what followed is replayed frame by frame
        ahead = frames[:, None] + np.arange(inputs.shape[1])
        cut = ahead[:, -1] > last
        ahead = np.minimum(ahead, last[:, None])
        paths = []
        for state, velocity, driven in zip(q0, v0, inputs, strict=True):
            apart = squared_norm(q - state, train.metric) / spread_q
            apart += squared_norm(v - velocity, train.metric) / spread_v
            apart += _compare_inputs(train.forcing, ahead, driven) / spread_u
            paths.append(
                train.encoded[ahead[np.argmin(apart if cut.all() else np.where(cut, np.inf, apart))]]
            )
        return np.stack(paths)

    return integrate


def _spread(series: Float64[np.ndarray, "T d"], metric: np.ndarray) -> float:
    return float(squared_norm(series - series.mean(axis=0), metric).mean()) or 1.0


def _compare_inputs(forcing: np.ndarray, ahead: np.ndarray, driven: np.ndarray) -> np.ndarray:
    """Mean squared difference of the inputs from each candidate on to those of a window."""
    apart = np.zeros(len(ahead))
    for column, given in zip(ahead.T, driven, strict=True):
        apart += np.sum((forcing[column] - given) ** 2, axis=1)
    return apart / len(driven)
