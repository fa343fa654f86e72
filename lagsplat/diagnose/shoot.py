"""Multiple shooting: parameters and the windows' starting states by Levenberg-Marquardt.

Minimises ``sum |(y - predicted)/sigma|^2 + sum ((x - mean)/deviation)^2`` over parameters ``x`` and the
starting state of every window. States enter only their own window, so that they are eliminated window by
window (Schur complement). Derivatives are differences of rollouts, all of them in one batch.

Source: Bock, "Recent advances in parameter identification for ODE", 1983; paper's rollouts, eq. (roll).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

Predict = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""From parameters (P, k) and starts (P, W, 2 d) to predictions (P, W, L, d)."""


@dataclass(frozen=True)
class Belief:
    """What is believed of the parameters beforehand: normal, cut off below ``lowest``."""

    mean: Float64[np.ndarray, " k"]
    deviation: Float64[np.ndarray, " k"]
    lowest: Float64[np.ndarray, " k"]
    step: Float64[np.ndarray, " k"]
    """Differences for derivatives."""


@dataclass(frozen=True)
class Data:
    """Samples (W, L, d) of the windows, one over their standard deviations, zero where there is none."""

    y: Float64[np.ndarray, "W L d"]
    weight: Float64[np.ndarray, "W L d"]
    start_step: Float64[np.ndarray, " s"]
    """Differences of the starting state, (2 d,)."""


@dataclass(frozen=True)
class Linear:
    """A least-squares problem about one point, the starting states already eliminated."""

    residual: Float64[np.ndarray, "W L d"]
    slopes: Float64[np.ndarray, "W M k"]
    start_slopes: Float64[np.ndarray, "W M s"]
    curvature: Float64[np.ndarray, "k k"]
    gradient: Float64[np.ndarray, " k"]
    log_det_starts: float


@dataclass(frozen=True)
class Fit:
    """Parameters ``x``, starts, the weighted residual there and the Gauss-Newton curvature of half the cost."""

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


def penalty(x: Float64[np.ndarray, "P k"], belief: Belief) -> Float64[np.ndarray, " P"]:
    """Sum of squares of the standardised parameters."""
    return np.sum(((x - belief.mean) / belief.deviation) ** 2, axis=1)


def derivatives(
    predict: Predict, x: np.ndarray, starts: np.ndarray, data: Data, step: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weighted residual (W, L, d), slopes of the prediction by parameters (W, M, k) and by starts (W, M, s)."""
    k, s = len(x), starts.shape[1]
    many = np.repeat(x[None], 1 + k + s, axis=0)
    begun = np.repeat(starts[None], 1 + k + s, axis=0)
    many[1 + np.arange(k), np.arange(k)] += step
    for i in range(s):
        begun[1 + k + i, :, i] += data.start_step[i]
    y = predict(many, begun)
    moved = np.concatenate([step, data.start_step])[:, None, None, None]
    slopes = (y[1:] - y[0]) / moved * data.weight
    flat = slopes.reshape(k + s, len(starts), -1).transpose(1, 2, 0)
    return (data.y - y[0]) * data.weight, flat[..., :k], flat[..., k:]


def eliminate(
    residual: np.ndarray, slopes: np.ndarray, start_slopes: np.ndarray, damping: float = 0.0
) -> tuple[np.ndarray, np.ndarray, float, np.ndarray, np.ndarray]:
    """Curvature and gradient of the parameters with the starts eliminated, and what gives the starts back."""
    flat = residual.reshape(len(residual), -1)
    own = np.einsum("wma,wmb->wab", start_slopes, start_slopes)
    diagonal = np.einsum("waa->wa", own)
    diagonal += damping * diagonal + 1e-12 * (diagonal.max(axis=1, keepdims=True) + 1e-30)
    cross = np.einsum("wma,wmk->wak", start_slopes, slopes)
    pull = np.einsum("wma,wm->wa", start_slopes, flat)
    solved = np.linalg.solve(own, np.concatenate([cross, pull[..., None]], axis=2))
    curvature = np.einsum("wmk,wml->kl", slopes, slopes) - np.einsum("wak,wal->kl", cross, solved[..., :-1])
    gradient = np.einsum("wmk,wm->k", slopes, flat) - np.einsum("wak,wa->k", cross, solved[..., -1])
    return curvature, gradient, float(np.linalg.slogdet(own)[1].sum()), solved[..., :-1], solved[..., -1]


def shoot(
    predict: Predict,
    x: Float64[np.ndarray, " k"],
    starts: Float64[np.ndarray, "W s"],
    data: Data,
    belief: Belief,
    *,
    iterations: int,
    tolerance: float,
) -> Fit:
    """Minimise from ``x`` and ``starts``; stops when a step gains less than ``tolerance`` of the cost."""
    damping = 1e-3
    inverse = 1.0 / belief.deviation**2
    cost, done = np.inf, 0
    residual, slopes, begun = derivatives(predict, x, starts, data, belief.step)
    misfit, paid = float(np.sum(residual**2)), float(penalty(x[None], belief)[0])
    cost = misfit + paid
    for done in range(1, iterations + 1):  # noqa: B007
        gained = False
        for _ in range(6):
            curvature, gradient, _, back, own = eliminate(residual, slopes, begun, damping)
            h = curvature + np.diag(inverse + damping * (np.diag(curvature) + inverse))
            g = gradient - (x - belief.mean) * inverse
            move = np.linalg.lstsq(h, g, rcond=1e-13)[0] if len(x) else g
            new = np.maximum(x + move, belief.lowest)
            new_starts = starts + own - np.einsum("wak,k->wa", back, new - x)
            tried = (data.y - predict(new[None], new_starts[None])[0]) * data.weight
            new_misfit = float(np.sum(tried**2))
            new_paid = float(penalty(new[None], belief)[0])
            if np.isfinite(new_misfit) and new_misfit + new_paid < cost:
                gained = True
                break
            damping = min(damping * 8.0 + 1e-6, 1e9)
        if not gained:
            break
        gain = cost - new_misfit - new_paid
        x, starts, cost, misfit, paid = new, new_starts, new_misfit + new_paid, new_misfit, new_paid
        damping = max(damping * 0.2, 1e-9)
        residual, slopes, begun = derivatives(predict, x, starts, data, belief.step)
        if gain < tolerance * cost + 1e-9:
            break
    curvature, _, log_det, _, _ = eliminate(residual, slopes, begun)
    return Fit(x, starts, residual, misfit, paid, curvature, log_det, done)
