"""Coordinates in which a driven motion is the linear response to its inputs.

Near its equilibrium a mechanism answers its inputs as a linear filter does, in coordinates that are straight.
An encoder may bend them at will, since its decoder follows. So of all linear functions of its features those
are taken that linear filters of the inputs explain best: a canonical correlation analysis. They do not fold,
however far an object moves, and coordinates are found that hardly change the image.

Source: Hotelling 1936, DOI 10.1093/biomet/28.3-4.321; of past inputs, Larimore 1990, "Canonical
variate analysis in identification, filtering, and adaptive control".
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float64, Int
from torch import Tensor, nn

from lagsplat.array_types import Series

# The numbers below were set by hand, with the simulated arms in view.
LAGS, LONGEST = 24, 256  # of the filters, and the longest [frames]; short lags lie closer
LEAST_SHARE = 0.5  # of the variance of every coordinate, which a filter must explain in other frames
LEAST_VARIANCE = 1e-4  # that filters leave: images tell no coordinate better
TINY = 1e-6  # singular values that are none, relative to the largest


@dataclass(frozen=True)
class InputHistory:
    """Inputs of a recording, and its segments, before which they are taken for constant."""

    inputs: Series
    segments: Sequence[tuple[int, int]]

    def before(self, frames: Int[np.ndarray, " N"]) -> Float64[np.ndarray, "N L"]:
        """Inputs at all lags before each of these frames."""
        begins = np.array([begin for begin, _ in self.segments])
        first = begins[np.searchsorted(begins, frames, side="right") - 1]
        lags = np.unique(np.round(np.linspace(0.0, 1.0, LAGS) ** 2 * LONGEST).astype(int))
        at = np.maximum(frames[:, None] - lags, first[:, None])
        return self.inputs[at].reshape(len(frames), -1)


class LinearResponse(nn.Module):
    """Filters of the inputs that say what is expected of latents, and what variance they leave open.

    A module, so that the state of a training run holds it.

    Args:
        latents: of some frames.
        history: of the same frames, see `InputHistory.before`.
    """

    filters: Tensor
    mean_history: Tensor
    mean: Tensor
    variance: Tensor

    def __init__(self, latents: Float64[np.ndarray, "N d"], history: Float64[np.ndarray, "N L"]) -> None:
        super().__init__()
        d, n_lags = latents.shape[1], history.shape[1]
        for name, shape in (("filters", (n_lags, d)), ("mean_history", n_lags), ("mean", d), ("variance", d)):
            self.register_buffer(name, torch.zeros(shape, dtype=torch.float64))
        self.fit(latents, history)

    def fit(self, latents: Float64[np.ndarray, "N d"], history: Float64[np.ndarray, "N L"]) -> None:
        """Fit the filters to latents by least squares; what they leave is noise and curvature."""
        mean, mean_history = latents.mean(axis=0), history.mean(axis=0)
        filters = np.linalg.lstsq(history - mean_history, latents - mean, rcond=TINY)[0]
        left = np.var(latents - mean - (history - mean_history) @ filters, axis=0)
        variance = np.maximum(left, LEAST_VARIANCE * latents.var(axis=0))
        fitted = {"filters": filters, "mean_history": mean_history, "mean": mean, "variance": variance}
        self.load_state_dict({name: torch.from_numpy(values) for name, values in fitted.items()})

    def predict(self, history: Float64[np.ndarray, "N L"]) -> Float64[Tensor, "N d"]:
        """Latents by the inputs."""
        return self.mean + (torch.from_numpy(history).to(self.mean) - self.mean_history) @ self.filters


def find_driven_functions(
    features: Float64[np.ndarray, "N F"], history: Float64[np.ndarray, "N L"], d: int
) -> Float64[np.ndarray, "F d"] | None:
    """Weights of the ``d`` linear functions of features that filters of the inputs explain best.

    Their values are uncorrelated and have unit variance. The result is None where in the second half of the
    frames a filter of the first half explains less than half of the variance of one of them: that coordinate
    is not driven, or there are too few frames.

    Args:
        features: of frames in the order of time.
        history: of the same frames, see `InputHistory.before`.
        d: number of coordinates.
    """
    half = len(features) // 2
    if half <= features.shape[1] + history.shape[1]:
        return None
    weights = _correlate(features[:half], history[:half], d)
    if weights.shape[1] < d:
        return None
    found = features @ weights
    expected = LinearResponse(found[:half], history[:half]).predict(history[half:]).numpy()
    left = np.var(found[half:] - expected, axis=0)
    if not np.all(left < (1.0 - LEAST_SHARE) * np.var(found[half:], axis=0)):
        return None
    return _correlate(features, history, d)


def _correlate(
    features: Float64[np.ndarray, "N F"], history: Float64[np.ndarray, "N L"], d: int
) -> Float64[np.ndarray, "F d"]:
    """Weights of the first canonical variables of features, at most ``d`` of them."""
    (left, of_left), (right, _) = _whiten(features), _whiten(history)
    axes = np.linalg.svd(left.T @ right / len(features), full_matrices=False)[0]
    return of_left @ axes[:, :d]


def _whiten(x: Float64[np.ndarray, "N k"]) -> tuple[Float64[np.ndarray, "N r"], Float64[np.ndarray, "k r"]]:
    left, sizes, right = np.linalg.svd(x - x.mean(axis=0), full_matrices=False)
    kept = sizes > TINY * max(sizes[0], 1e-30)
    root = np.sqrt(len(x))
    return left[:, kept] * root, right[kept].T / sizes[kept] * root
