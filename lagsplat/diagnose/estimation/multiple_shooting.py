"""Multiple shooting: parameters and the windows' initial states by the Levenberg-Marquardt method.

Minimises ``sum |(y - predicted)/sigma|^2 + sum ((x - mean)/deviation)^2`` over parameters ``x`` and the
initial state of every window, which is eliminated (`lagsplat.normal_equations`). Derivatives are finite
differences of rollouts, all in one batch.

Source: Bock, "Recent advances in parameter identification techniques for o.d.e.", 1983; the paper's
rollouts, eq. (roll).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from lagsplat.diagnose.core.config import ESTIMATION
from lagsplat.diagnose.estimation.dataset import Dataset, WindowSet
from lagsplat.integer_lists import choose_evenly
from lagsplat.normal_equations import EliminatedStates, NormalEquations, eliminate_states

PredictionFunction = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""From parameters (P, k) and initial states (P, W, 2 d) to predictions (P, W, L, d)."""


@dataclass(frozen=True)
class GaussianPrior:
    """Prior of the parameters: normal, cut off below ``lowest``."""

    mean: Float64[np.ndarray, " k"]
    deviation: Float64[np.ndarray, " k"]
    lowest: Float64[np.ndarray, " k"]
    step: Float64[np.ndarray, " k"]  # steps of finite differences


@dataclass(frozen=True)
class ShootingData:
    """Samples of the windows, and how much each counts."""

    y: Float64[np.ndarray, "W L d"]
    weight: Float64[np.ndarray, "W L d"]
    """One over the standard deviation of a sample, zero where there is none."""
    start_step: Float64[np.ndarray, " s"]  # steps of finite differences of the initial state, (2 d,)

    @classmethod
    def of(cls, dataset: Dataset, windows: WindowSet, deviation: Float64[np.ndarray, " d"]) -> "ShootingData":
        """The samples of ``windows``; ``deviation`` is that of a sample of noise as usual."""
        relative = windows.take(np.broadcast_to(dataset.relative_noise, len(dataset.time)))
        sizes = np.std(dataset.q, axis=0), np.std(dataset.v, axis=0)
        weight = (windows.mask() / relative)[..., None] / deviation
        return cls(windows.take(dataset.q), weight, 1e-4 * np.concatenate(sizes))


Linearization = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Weighted residual (W, L, d), its prediction's derivatives by parameters (W, M, k) and starts (W, M, s)."""


@dataclass(frozen=True)
class ShootingFit:
    """The result of multiple shooting."""

    x: Float64[np.ndarray, " k"]  # parameters
    starts: Float64[np.ndarray, "W s"]  # initial states of the windows
    residual: Float64[np.ndarray, "W L d"]  # weighted residual
    misfit: float  # sum of squares of the weighted residual
    penalty: float
    """Sum of squares of the parameters' distances from their prior means, in standard deviations."""
    curvature: Float64[np.ndarray, "k k"]
    """Gauss-Newton curvature of half the misfit by the parameters, initial states eliminated."""
    log_det_starts: float  # log determinant of the curvature by the initial states
    slopes: Float64[np.ndarray, "W M k"]  # derivatives of the weighted prediction by the parameters; M = L d
    start_slopes: Float64[np.ndarray, "W M s"]  # the same by the initial states

    @property
    def cost(self) -> float:
        """Misfit and penalty together."""
        return self.misfit + self.penalty

    def select(self, windows: Int64[np.ndarray, " V"], frames: int) -> "ShootingFit":
        """The fit as seen by some of its windows, the longest of which has so many ``frames``.

        Sums over all windows (misfit, curvature) stay those of the whole.
        """
        residual = self.residual[windows, :frames]
        size = residual[0].size
        slopes, start_slopes = self.slopes[windows, :size], self.start_slopes[windows, :size]
        return replace(
            self, starts=self.starts[windows], residual=residual, slopes=slopes, start_slopes=start_slopes
        )


def compute_penalty(x: Float64[np.ndarray, "P k"], prior: GaussianPrior) -> Float64[np.ndarray, " P"]:
    """Sum of squares of the parameters' distances from their prior means, in standard deviations."""
    return np.sum(((x - prior.mean) / prior.deviation) ** 2, axis=1)


def differentiate_predictions(
    predict: PredictionFunction,
    x: Float64[np.ndarray, " k"],
    starts: Float64[np.ndarray, "W s"],
    data: ShootingData,
    step: Float64[np.ndarray, " k"],
    *,
    leading: int | None = None,
) -> Linearization:
    """Linearise ``predict`` by finite differences about parameters and initial states.

    With ``leading``, derivatives are by so many of the first parameters alone, and by no start.
    ``step`` are the steps of the finite differences.
    """
    k, s = (len(x), starts.shape[1]) if leading is None else (leading, 0)
    shifted = np.repeat(x[None], 1 + k + s, axis=0)
    shifted_starts = np.repeat(starts[None], 1 + k + s, axis=0)
    shifted[1 + np.arange(k), np.arange(k)] += step[:k]
    for i in range(s):
        shifted_starts[1 + k + i, :, i] += data.start_step[i]
    y = predict(shifted, shifted_starts)
    slopes = np.empty((k + s, len(starts), data.y[0].size))
    for i, size in enumerate([*step[:k], *data.start_step[:s]]):
        slopes[i] = ((y[1 + i] - y[0]) / size * data.weight).reshape(slopes[i].shape)
    slopes = slopes.transpose(1, 2, 0)
    return (data.y - y[0]) * data.weight, slopes[..., :k], slopes[..., k:]


def eliminate_starts(
    residual: np.ndarray, slopes: np.ndarray, start_slopes: np.ndarray, damping: float = 0.0
) -> EliminatedStates:
    """Normal equations of the parameters after elimination of the initial states.

    The first arguments are what `differentiate_predictions` returns; ``damping`` is added to the curvature by
    the initial states, as a share of its diagonal.
    """
    flat, transposed = residual.reshape(len(residual), -1, 1), start_slopes.mT
    states = transposed @ start_slopes
    diagonal = np.einsum("waa->wa", states)
    diagonal += 1e-12 * (diagonal.max(axis=1, keepdims=True) + 1e-30)  # a window without samples
    rows = slopes.reshape(residual.size, slopes.shape[2])  # of no parameters, too
    gradients = -(transposed @ flat)[..., 0], -rows.T @ flat.ravel()
    normal = NormalEquations(states, transposed @ slopes, rows.T @ rows, *gradients)
    return eliminate_states(normal, damping=damping)


def fit_multiple_shooting(
    predict: PredictionFunction,
    x: Float64[np.ndarray, " k"],
    starts: Float64[np.ndarray, "W s"],
    data: ShootingData,
    prior: GaussianPrior,
    *,
    iterations: int,
    tolerance: float,
    known: tuple[np.ndarray, np.ndarray] | None = None,
    brief: bool = False,
) -> ShootingFit:
    """Fit parameters and initial states; stops when a step gains less than ``tolerance`` of the cost.

    Args:
        predict, data, prior: the rollouts, the samples, and the prior of the parameters.
        x, starts: parameters and initial states to begin with.
        iterations: steps at most.
        tolerance: relative gain of a step below which the fit has converged.
        known: derivatives by the last parameters and by the starts, from a fit nearby. Those by the first
            parameters are then computed after every step, the rest, which change little, every
            `ESTIMATION.max_stale_steps`.
        brief: whether the last derivatives may be those of a few steps before, as for a fit to be continued.
    """
    n_leading = len(x) if known is None else len(x) - known[0].shape[2]

    def linearize(x: np.ndarray, starts: np.ndarray) -> Linearization:
        return differentiate_predictions(predict, x, starts, data, prior.step)

    def update(x: np.ndarray, starts: np.ndarray, trailing: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        arguments = (predict, x, starts, data, prior.step)
        residual, leading, _ = differentiate_predictions(*arguments, leading=n_leading)
        return residual, np.concatenate([leading, trailing], axis=2)

    damping = 1e-3  # a share of the curvature: a fifth after a success, eightfold after a failure
    age = 0 if known is None else 1  # steps since all derivatives were computed
    if known is None:
        residual, slopes, start_slopes = linearize(x, starts)
    else:
        (residual, slopes), start_slopes = update(x, starts, known[0]), known[1]
    misfit, penalty = float(np.sum(residual**2)), float(compute_penalty(x[None], prior)[0])
    cost = misfit + penalty
    for _ in range(iterations):
        step = _step(predict, x, starts, data, prior, (residual, slopes, start_slopes), cost, damping)
        if step is None and age == 0:
            break
        gain = 0.0
        if step is not None:
            x, starts, misfit, penalty, damping = step
            gain, cost = cost - misfit - penalty, misfit + penalty
        converged = gain < tolerance * cost + 1e-9
        if not converged and known is not None and age < ESTIMATION.max_stale_steps:
            residual, slopes = update(x, starts, slopes[..., n_leading:])
            age += 1
            continue
        residual, slopes, start_slopes = linearize(x, starts)
        fresh, age = age == 0, 0
        if converged and fresh:
            break
    if age and not brief:
        residual, slopes, start_slopes = linearize(x, starts)
    left = eliminate_starts(residual, slopes, start_slopes)
    curvatures = left.curvature, left.log_determinant
    return ShootingFit(x, starts, residual, misfit, penalty, *curvatures, slopes, start_slopes)


def _step(
    predict: PredictionFunction,
    x: np.ndarray,
    starts: np.ndarray,
    data: ShootingData,
    prior: GaussianPrior,
    linear: Linearization,
    cost: float,
    damping: float,
) -> tuple[np.ndarray, np.ndarray, float, float, float] | None:
    """A step that lowers the cost, with its misfit, its penalty and the next damping.

    None if `ESTIMATION.max_attempts` dampings, each stronger than the last, fail.
    """
    inverse = 1.0 / prior.deviation**2
    for _ in range(ESTIMATION.max_attempts):
        left = eliminate_starts(*linear, damping)
        h = left.curvature + np.diag(inverse + damping * (np.diag(left.curvature) + inverse))
        g = left.right - (x - prior.mean) * inverse
        if not (np.isfinite(h).all() and np.isfinite(g).all()):
            return None  # a diverged rollout has no derivative to follow
        move = np.linalg.lstsq(h, g, rcond=1e-13)[0] if len(x) else g
        new = np.maximum(x + move, prior.lowest)
        new_starts = starts + left.follow(new - x)
        residual = (data.y - predict(new[None], new_starts[None])[0]) * data.weight
        misfit, penalty = float(np.sum(residual**2)), float(compute_penalty(new[None], prior)[0])
        if np.isfinite(misfit) and misfit + penalty < cost:
            return new, new_starts, misfit, penalty, max(damping * 0.2, 1e-9)
        damping = min(damping * 8.0 + 1e-6, 1e9)
    return None


def measure_windows(
    residual: Float64[np.ndarray, "W L d"], length: Int64[np.ndarray, " W"]
) -> Float64[np.ndarray, " W"]:
    """Mean square of the weighted residual of each window [noise variances]; ``length`` are its frames."""
    return np.array([(row[:n] ** 2).mean() for row, n in zip(residual, length, strict=True)])


def choose_windows(fit: ShootingFit, length: Int64[np.ndarray, " W"], most: int) -> Int64[np.ndarray, " V"]:
    """At most ``most`` windows, evenly spaced in the order of what the fit leaves of them.

    Those of which it leaves the most are among them: there an effect that acts rarely acts.
    """
    left = measure_windows(fit.residual, length)
    return np.sort(np.argsort(-left)[choose_evenly(len(left), most)])


def compute_autocorrelation_time(residual: Float64[np.ndarray, "W L d"], length: np.ndarray) -> float:
    """Samples that count as one: the two-sided sum of the autocorrelation to its first zero.

    Source: the integrated autocorrelation time with the initial positive sequence (Geyer 1992).
    """
    power = float(sum((row[:n] ** 2).sum() for row, n in zip(residual, length, strict=True)))
    total = 1.0
    for lag in range(1, residual.shape[1]):
        rows = [row[: n - lag] * row[lag:n] for row, n in zip(residual, length, strict=True) if n > lag]
        share = float(sum(row.sum() for row in rows)) / max(power, 1e-300)
        if share <= 0.0:
            break
        total += 2.0 * share
    return total
