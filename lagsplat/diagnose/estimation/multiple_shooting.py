"""Multiple shooting: parameters and the windows' starting states by Levenberg-Marquardt.

Minimises ``sum |(y - predicted)/sigma|^2 + sum ((x - mean)/deviation)^2`` over parameters ``x`` and the
starting state of every window. States enter only their own window, so that they are eliminated window by
window (Schur complement). Derivatives are differences of rollouts, all of them in one batch, unless exact
ones are handed over.

Source: Bock, "Recent advances in parameter identification for ODE", 1983; paper's rollouts, eq. (roll).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

PredictionFunction = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""From parameters (P, k) and starts (P, W, 2 d) to predictions (P, W, L, d)."""


@dataclass(frozen=True)
class GaussianPrior:
    """What is believed of the parameters beforehand: normal, cut off below ``lowest``."""

    mean: Float64[np.ndarray, " k"]
    deviation: Float64[np.ndarray, " k"]
    lowest: Float64[np.ndarray, " k"]
    step: Float64[np.ndarray, " k"]
    """Differences for derivatives."""


@dataclass(frozen=True)
class ShootingData:
    """Samples (W, L, d) of the windows, one over their standard deviations, zero where there is none."""

    y: Float64[np.ndarray, "W L d"]
    weight: Float64[np.ndarray, "W L d"]
    start_step: Float64[np.ndarray, " s"]
    """Differences of the starting state, (2 d,)."""


LinearizationFunction = Callable[
    [np.ndarray, np.ndarray, ShootingData], tuple[np.ndarray, np.ndarray, np.ndarray]
]
"""What `differentiate_predictions` says of parameters, starts and data, worked out in another way."""


@dataclass(frozen=True)
class ShootingFit:
    """Parameters ``x``, starts, the weighted residual and the Gauss-Newton curvature of half the cost."""

    x: Float64[np.ndarray, " k"]
    starts: Float64[np.ndarray, "W s"]
    residual: Float64[np.ndarray, "W L d"]
    misfit: float
    """Sum of squares of the weighted residual."""
    penalty: float
    """Sum of squares of the parameters' distance from their beliefs."""
    curvature: Float64[np.ndarray, "k k"]
    """Of the data alone, starts eliminated."""
    log_det_starts: float
    iterations: int
    slopes: Float64[np.ndarray, "W M k"]
    """Of the weighted prediction by the parameters."""
    start_slopes: Float64[np.ndarray, "W M s"]

    @property
    def cost(self) -> float:
        """Misfit, and what the moved parameters cost."""
        return self.misfit + self.penalty


def compute_penalty(x: Float64[np.ndarray, "P k"], belief: GaussianPrior) -> Float64[np.ndarray, " P"]:
    """Sum of squares of the standardised parameters."""
    return np.sum(((x - belief.mean) / belief.deviation) ** 2, axis=1)


def differentiate_predictions(
    predict: PredictionFunction, x: np.ndarray, starts: np.ndarray, data: ShootingData, step: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weighted residual (W, L, d), slopes by parameters (W, M, k) and by starts (W, M, s)."""
    k, s = len(x), starts.shape[1]
    many = np.repeat(x[None], 1 + k + s, axis=0)
    begun = np.repeat(starts[None], 1 + k + s, axis=0)
    many[1 + np.arange(k), np.arange(k)] += step
    for i in range(s):
        begun[1 + k + i, :, i] += data.start_step[i]
    y = predict(many, begun)
    slopes = _quotients(y, np.concatenate([step, data.start_step]), data)
    return (data.y - y[0]) * data.weight, slopes[..., :k], slopes[..., k:]


def differentiate_leading_parameters(
    predict: PredictionFunction,
    x: np.ndarray,
    starts: np.ndarray,
    data: ShootingData,
    step: np.ndarray,
    n: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Weighted residual, and slopes by the first ``n`` parameters alone."""
    if n == 0:
        residual = (data.y - predict(x[None], starts[None])[0]) * data.weight
        return residual, np.zeros((len(starts), residual[0].size, 0))
    many = np.repeat(x[None], 1 + n, axis=0)
    many[1 + np.arange(n), np.arange(n)] += step[:n]
    y = predict(many, np.repeat(starts[None], 1 + n, axis=0))
    return (data.y - y[0]) * data.weight, _quotients(y, step[:n], data)


def _quotients(y: np.ndarray, step: np.ndarray, data: ShootingData) -> np.ndarray:
    slopes = (y[1:] - y[0]) / step[:, None, None, None] * data.weight
    return slopes.reshape(len(step), y.shape[1], -1).transpose(1, 2, 0)


def eliminate_starts(
    residual: np.ndarray, slopes: np.ndarray, start_slopes: np.ndarray, damping: float = 0.0
) -> tuple[np.ndarray, np.ndarray, float, np.ndarray, np.ndarray]:
    """Curvature and gradient of the parameters with the starts eliminated, and what gives the starts back."""
    flat = residual.reshape(len(residual), -1)
    across = start_slopes.transpose(0, 2, 1)
    own = across @ start_slopes
    diagonal = np.einsum("waa->wa", own)
    diagonal += damping * diagonal + 1e-12 * (diagonal.max(axis=1, keepdims=True) + 1e-30)
    cross = across @ slopes
    pull = (across @ flat[..., None])[..., 0]
    solved = np.linalg.solve(own, np.concatenate([cross, pull[..., None]], axis=2))
    k = slopes.shape[2]
    every, shared = (x.transpose(2, 0, 1).reshape(k, len(x) * x.shape[1]) for x in (slopes, cross))
    curvature = every @ every.T - shared @ solved[..., :-1].reshape(shared.shape[1], k)
    gradient = every @ flat.reshape(-1) - shared @ solved[..., -1].reshape(-1)
    return curvature, gradient, float(np.linalg.slogdet(own)[1].sum()), solved[..., :-1], solved[..., -1]


MAX_STALE_STEPS = 4
"""Steps after which all slopes are taken anew."""


def fit_multiple_shooting(
    predict: PredictionFunction,
    x: Float64[np.ndarray, " k"],
    starts: Float64[np.ndarray, "W s"],
    data: ShootingData,
    belief: GaussianPrior,
    *,
    iterations: int,
    tolerance: float,
    known: tuple[np.ndarray, np.ndarray] | None = None,
    exact: LinearizationFunction | None = None,
) -> ShootingFit:
    """Minimise from ``x`` and ``starts``; stops when a step gains less than ``tolerance`` of the cost.

    ``exact`` derivatives take the place of differences. ``known`` are slopes by the last parameters and by
    the starts from a fit nearby: those of the first parameters are then taken anew after every step and the
    rest now and then, for they change little.
    """

    def linear(x: np.ndarray, starts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return (
            exact(x, starts, data)
            if exact
            else differentiate_predictions(predict, x, starts, data, belief.step)
        )

    n_own = 0 if known is None else len(x) - known[0].shape[2]
    damping = 1e-3
    inverse = 1.0 / belief.deviation**2
    done, age = 0, 0
    if known is None:
        residual, slopes, begun = linear(x, starts)
    else:
        residual, own = differentiate_leading_parameters(predict, x, starts, data, belief.step, n_own)
        slopes, begun = np.concatenate([own, known[0]], axis=2), known[1]
        age = 1
    misfit, paid = float(np.sum(residual**2)), float(compute_penalty(x[None], belief)[0])
    cost = misfit + paid
    while done < iterations:
        done += 1
        step = _step(predict, x, starts, data, belief, (residual, slopes, begun), cost, damping, inverse)
        if step is None and age == 0:
            break
        gain = 0.0
        if step is not None:
            x, starts, misfit, paid, damping = step
            gain, cost = cost - misfit - paid, misfit + paid
        if gain >= tolerance * cost + 1e-9 and known is not None and age < MAX_STALE_STEPS:
            residual, own = differentiate_leading_parameters(predict, x, starts, data, belief.step, n_own)
            slopes = np.concatenate([own, slopes[..., n_own:]], axis=2)
            age += 1
            continue
        fresh = age == 0
        residual, slopes, begun = linear(x, starts)
        age = 0
        if gain < tolerance * cost + 1e-9 and fresh:
            break
    if age:
        residual, slopes, begun = linear(x, starts)
    curvature, _, log_det, _, _ = eliminate_starts(residual, slopes, begun)
    return ShootingFit(x, starts, residual, misfit, paid, curvature, log_det, done, slopes, begun)


def _step(
    predict: PredictionFunction,
    x: np.ndarray,
    starts: np.ndarray,
    data: ShootingData,
    belief: GaussianPrior,
    linear: tuple[np.ndarray, np.ndarray, np.ndarray],
    cost: float,
    damping: float,
    inverse: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, float, float, float] | None:
    """A step that lowers the cost, with its misfit, its penalty and the next damping; None if six fail."""
    for _ in range(6):
        curvature, gradient, _, back, own = eliminate_starts(*linear, damping)
        h = curvature + np.diag(inverse + damping * (np.diag(curvature) + inverse))
        g = gradient - (x - belief.mean) * inverse
        move = np.linalg.lstsq(h, g, rcond=1e-13)[0] if len(x) else g
        new = np.maximum(x + move, belief.lowest)
        new_starts = starts + own - np.einsum("wak,k->wa", back, new - x)
        tried = (data.y - predict(new[None], new_starts[None])[0]) * data.weight
        misfit, paid = float(np.sum(tried**2)), float(compute_penalty(new[None], belief)[0])
        if np.isfinite(misfit) and misfit + paid < cost:
            return new, new_starts, misfit, paid, max(damping * 0.2, 1e-9)
        damping = min(damping * 8.0 + 1e-6, 1e9)
    return None
