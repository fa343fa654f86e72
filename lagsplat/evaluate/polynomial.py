"""A smooth map from latents to true coordinates, read off frames at which both are known."""

from collections.abc import Callable
from itertools import combinations_with_replacement

import numpy as np
from jaxtyping import Float64

DEGREE = 3
RIDGE = 1e-9


def fit_polynomial(
    q: Float64[np.ndarray, "T d"], states: Float64[np.ndarray, "T n"]
) -> Callable[[Float64[np.ndarray, "N d"]], Float64[np.ndarray, "N n"]]:
    """The cubic polynomial of ``q`` that fits ``states`` best, by least squares with a small ridge.

    The ridge is relative to the mean square of the monomials and only keeps directions without motion from
    being fitted to rounding.

    Source: Hastie, Tibshirani and Friedman, The Elements of Statistical Learning, section 3.4.1.
    """
    monomials = _monomials(q)
    scale = np.maximum(np.sqrt(np.mean(monomials**2, axis=0)), 1e-12)
    scaled = monomials / scale
    moments = scaled.T @ scaled / len(q)
    weights = np.linalg.solve(moments + RIDGE * np.eye(len(scale)), scaled.T @ states / len(q))

    def predict(points: np.ndarray) -> np.ndarray:
        return (_monomials(points) / scale) @ weights

    return predict


def _monomials(q: np.ndarray) -> np.ndarray:
    columns = [np.ones(len(q))]
    for degree in range(1, DEGREE + 1):
        for chosen in combinations_with_replacement(range(q.shape[1]), degree):
            columns.append(np.prod(q[:, list(chosen)], axis=1))
    return np.stack(columns, axis=1)
