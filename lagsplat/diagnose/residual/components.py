"""What the residual depends on: shares of groups of features, correlations with single signals."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import permutations
from math import factorial

import numpy as np
from jaxtyping import Float64
from scipy.signal import correlate

from lagsplat.diagnose.core.config import RESIDUAL_REGRESSION
from lagsplat.diagnose.residual.features import FEATURE_GROUPS, ResidualFeatures, compute_input_rates
from lagsplat.diagnose.residual.latent_force import LatentForceEstimate, join_signals


def compute_components(
    features: ResidualFeatures, coordinate_share: Float64[np.ndarray, " d"]
) -> dict[str, float]:
    """Attribute the residual to the groups, weighting each coordinate by its own share (d,) of the residual.

    Shares are by group, with "unexplained", and sum to one.

    What groups explain together is divided by Shapley's rule (LMG). Memory gets only what no present quantity
    explains: in a swing, the position a quarter of a period ago resembles the velocity now.

    Source: Lindeman, Merenda, Gold (1980) and Groemping (2007) for the shares.
    """
    shares = dict.fromkeys((*FEATURE_GROUPS, "unexplained"), 0.0)
    for i in np.flatnonzero(coordinate_share > 0.01):
        coordinate_shares = _compute_shapley_shares(features, int(i))
        shares = {name: shares[name] + coordinate_share[i] * coordinate_shares[name] for name in shares}
    total = sum(shares.values())
    if total <= 0.0:
        return shares | {"unexplained": 1.0}
    return {name: float(share / total) for name, share in shares.items()}


class _FoldedRegression:
    """Normal equations of one coordinate's regression, fold by fold."""

    def __init__(self, features: ResidualFeatures, coordinate: int, columns: np.ndarray) -> None:
        weight = features.weight[:, coordinate]
        weight = weight / weight.sum()
        rms = np.sqrt(weight @ columns**2)
        x = np.sqrt(weight)[:, None] * columns / np.where(rms > 0.0, rms, 1.0)
        y = np.sqrt(weight) * features.target[:, coordinate]
        folds = [features.fold == fold for fold in range(RESIDUAL_REGRESSION.folds)]
        self.gram = np.stack([x[fold].T @ x[fold] for fold in folds])
        self.moment = np.stack([x[fold].T @ y[fold] for fold in folds])
        self.square = float(y @ y)

    def score(self, chosen: np.ndarray) -> float:
        """Share of the residual's square that the ``chosen`` columns predict on left-out folds.

        It is measured against zero, not the mean, because a constant force is a finding; it is the best of
        `RESIDUAL_REGRESSION.ridges`, and at least zero.
        """
        if not len(chosen) or self.square <= 0.0:
            return 0.0
        gram = self.gram[:, chosen][:, :, chosen]
        moment = self.moment[:, chosen]
        best = 0.0
        for ridge in RESIDUAL_REGRESSION.ridges:
            gram_rest = gram.sum(axis=0) - gram + ridge * np.eye(len(chosen))
            beta = np.linalg.solve(gram_rest, (moment.sum(axis=0) - moment)[..., None])[..., 0]
            error = np.einsum("fa,fab,fb->", beta, gram, beta) - 2.0 * np.sum(beta * moment)
            best = max(best, float(-error / self.square))
        return best


def _compute_shapley_shares(features: ResidualFeatures, coordinate: int) -> dict[str, float]:
    """Share of each group and of what is unexplained, for one coordinate."""
    groups = features.groups[coordinate]
    present = [name for name in FEATURE_GROUPS[:-1] if groups[name].shape[1]]
    ends = np.cumsum([groups[name].shape[1] for name in FEATURE_GROUPS])
    columns = dict(zip(FEATURE_GROUPS, np.split(np.arange(ends[-1]), ends[:-1]), strict=True))
    fit = _FoldedRegression(features, coordinate, np.concatenate(list(groups.values()), axis=1))

    @cache
    def value(names: frozenset[str]) -> float:
        return fit.score(np.concatenate([np.zeros(0, dtype=int), *(columns[name] for name in sorted(names))]))

    shares = dict.fromkeys(FEATURE_GROUPS, 0.0)
    for order in permutations(present):
        for k, name in enumerate(order):
            gain = value(frozenset(order[: k + 1])) - value(frozenset(order[:k]))
            shares[name] += gain / factorial(len(present))
    now = value(frozenset(present))
    shares["memory"] = value(frozenset((*present, "memory"))) - now
    positive = {name: max(0.0, share) for name, share in shares.items()}
    # A group that only adds noise has a negative share; the others are scaled to sum to what is explained.
    sum_now = sum(positive[name] for name in present)
    for name in present:
        positive[name] *= now / sum_now if sum_now > 0.0 else 0.0
    return positive | {"unexplained": max(0.0, 1.0 - sum(positive.values()))}


@dataclass(frozen=True)
class ResidualCorrelations:
    """Correlation of each coordinate's residual with each regressor."""

    coordinates: tuple[str, ...]
    regressors: tuple[str, ...]
    score: Float64[np.ndarray, "d k"]
    """Absolute correlation over the bound that chance exceeds once in twenty times; zero where a coordinate
    has no residual or a regressor does not vary."""


def compute_residual_correlations(
    estimates: Sequence[LatentForceEstimate], *, q_names: Sequence[str], u_names: Sequence[str]
) -> ResidualCorrelations:
    """Correlate each coordinate's residual with inputs, their rates, its own position and velocity, and time.

    The correlation of two smooth series scatters far more than that of white ones: its variance is the sum
    over all lags of the product of their autocorrelations over the number of samples.

    Source: Bartlett (1935), doi:10.2307/2342284.
    """
    lengths = [stop - start for estimate in estimates for start, stop in estimate.motion.segments]
    u, time_s, *motion = join_signals(estimates, "u", "time_s", "q", "v", "residual")
    rates = np.concatenate([compute_input_rates(estimate.motion) for estimate in estimates])
    inputs = {name: u[:, j] for j, name in enumerate(u_names)}
    inputs |= {f"d{name}/dt": rates[:, j] for j, name in enumerate(u_names)}
    names: tuple[str, ...] = ()
    rows = []
    for q, v, residual in zip(*(signal.T for signal in motion), strict=True):
        centred = q - q.mean()
        regressors = inputs | {"q": q, "q²": centred**2, "q³": centred**3}
        regressors |= {"v": v, "sign v": np.sign(v), "|v| v": np.abs(v) * v, "t": time_s}
        names = tuple(regressors)
        rows.append([_score_correlation(residual, column, lengths) for column in regressors.values()])
    return ResidualCorrelations(tuple(q_names), names, np.array(rows))


def _score_correlation(residual: np.ndarray, column: np.ndarray, lengths: Sequence[int]) -> float:
    """Absolute correlation of two series of several clips, over the bound that chance seldom exceeds."""
    first, second = (series - series.mean() for series in (residual, column))
    power = np.sqrt((first @ first) * (second @ second))
    # A constant leaves only rounding errors.
    if power <= 1e-12 * len(first) * np.abs(column).max(initial=0.0) * np.abs(residual).max(initial=0.0):
        return 0.0
    clips = zip(*(np.split(series, np.cumsum(lengths)[:-1]) for series in (first, second)), strict=True)
    # autocorrelations at every lag
    spread = sum(float(correlate(a, a) @ correlate(b, b)) / len(a) for a, b in clips)
    bound = RESIDUAL_REGRESSION.correlation_z * np.sqrt(max(spread, np.finfo(float).tiny))
    return float(abs(first @ second) / bound)
