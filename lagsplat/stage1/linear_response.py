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
from jaxtyping import Float64, Int

from lagsplat.array_types import Series

# The numbers below were set by hand, with the simulated arms in view.
LAGS = np.unique(np.round(np.linspace(0.0, 1.0, 24) ** 2 * 256).astype(int))
"""Of the filters [frames]: short ones lie closer."""
LEAST_SHARE = 0.5  # of the variance of every coordinate, which a filter must explain in other frames
LEAST_VARIANCE = 1e-4  # that filters leave: images tell no coordinate better
FAINT = 1e-3  # variations of features that are left out, relative to the largest: weights would be huge
TINY = 1e-6  # the same for inputs, where they repeat each other


@dataclass(frozen=True)
class InputHistory:
    """Inputs of a recording, and its segments, before which they are taken for constant."""

    inputs: Series
    segments: Sequence[tuple[int, int]]

    def before(self, frames: Int[np.ndarray, " N"]) -> Float64[np.ndarray, "N L"]:
        """Inputs at all `LAGS` before each of these frames, a row for each."""
        begins = np.array([begin for begin, _ in self.segments])
        first = begins[np.searchsorted(begins, frames, side="right") - 1]
        at = np.maximum(frames[:, None] - LAGS, first[:, None])
        return self.inputs[at].reshape(len(frames), -1)


@dataclass(frozen=True)
class LinearResponse:
    """Linear functions of features, and the linear filters of the inputs that explain them.

    ``weights`` and ``filters`` are of features and of inputs less their means. ``variance`` is what the
    filters leave of the functions, which have unit variance.
    """

    weights: Float64[np.ndarray, "F d"]
    filters: Float64[np.ndarray, "L d"]
    mean_features: Float64[np.ndarray, " F"]
    mean_history: Float64[np.ndarray, " L"]
    variance: Float64[np.ndarray, " d"]

    def predict(self, history: Float64[np.ndarray, "N L"]) -> Float64[np.ndarray, "N d"]:
        """Values of the functions by the inputs, see `InputHistory.before`."""
        return (history - self.mean_history) @ self.filters


def fit_linear_response(
    features: Float64[np.ndarray, "N F"], history: Float64[np.ndarray, "N L"], d: int
) -> LinearResponse | None:
    """Find the ``d`` linear functions of features that filters of the inputs explain best.

    Their values are uncorrelated and have unit variance. The result is None where in the second half of the
    frames a filter of the first half explains less than half of the variance of one of them: that coordinate
    is not driven, or there are too few frames. Inputs that never move explain nothing.

    Args:
        features: of frames in the order of time.
        history: of the same frames, see `InputHistory.before`.
        d: number of coordinates.
    """
    half = len(features) // 2
    moving = np.ptp(history, axis=0).any()
    if not moving or half <= features.shape[1] + history.shape[1] or features.shape[1] < d:
        return None
    first = _correlate(features[:half], history[:half], d)
    if len(first.variance) < d:
        return None
    found = (features[half:] - first.mean_features) @ first.weights
    left = np.var(found - first.predict(history[half:]), axis=0)
    if not np.all(left < (1.0 - LEAST_SHARE) * np.var(found, axis=0)):
        return None
    return _correlate(features, history, d)


def _correlate(
    features: Float64[np.ndarray, "N F"], history: Float64[np.ndarray, "N L"], d: int
) -> LinearResponse:
    """The first canonical variables of features, at most ``d`` of them."""
    (left, of_left), (right, of_right) = _whiten(features, least=FAINT), _whiten(history, least=TINY)
    axes, correlations, others = np.linalg.svd(left.T @ right / len(features), full_matrices=False)
    correlations = correlations[:d]
    return LinearResponse(
        weights=of_left @ axes[:, :d],
        filters=of_right @ others[:d].T * correlations,
        mean_features=features.mean(axis=0),
        mean_history=history.mean(axis=0),
        variance=np.maximum(1.0 - correlations**2, LEAST_VARIANCE),
    )


def _whiten(
    x: Float64[np.ndarray, "N k"], *, least: float
) -> tuple[Float64[np.ndarray, "N r"], Float64[np.ndarray, "k r"]]:
    left, sizes, right = np.linalg.svd(x - x.mean(axis=0), full_matrices=False)
    kept = sizes > least * max(sizes[0], 1e-30)
    root = np.sqrt(len(x))
    return left[:, kept] * root, right[kept].T / sizes[kept] * root
