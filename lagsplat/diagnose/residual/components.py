"""Which kind of term the residual is: shares of what groups of features predict on blocks left out.

What the residual force goes with: its correlation with whatever may drive it, over what chance reaches.

The correlation of two series that are both smooth scatters far more than that of white ones: its variance is
the sum over all lags of the product of their autocorrelations (Bartlett 1935, doi:10.2307/2342284), over the
number of samples.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import factorial

import numpy as np
from jaxtyping import Float64
from scipy.signal import correlate
from sklearn.kernel_ridge import KernelRidge

from lagsplat.diagnose.core.config import COMPONENTS, RESIDUAL_FEATURES
from lagsplat.diagnose.residual.features import FEATURE_GROUPS, ResidualFeatures, compute_input_rates
from lagsplat.diagnose.residual.latent_force import LatentForceEstimate


@dataclass(frozen=True)
class ResidualComponents:
    """``shares`` of the residual by group, and ``unexplained``, summing to one; ``compute_memory_index``:
    what the past adds to a prediction from the present, without assuming a form; both over all
    coordinates."""

    shares: dict[str, float]
    memory_index: float

    @property
    def largest(self) -> str:
        """The group of largest share."""
        return max(FEATURE_GROUPS, key=lambda name: self.shares[name])


def compute_components(
    found: ResidualFeatures, coordinate_share: Float64[np.ndarray, " d"]
) -> ResidualComponents:
    """Shares of every group, coordinates weighted by their own share of the residual.

    Groups share what they explain together by Shapley's rule (LMG), but memory gets only what no present
    quantity explains: in a swing, a quarter of a period ago looks like the velocity now.

    Source: Lindeman, Merenda, Gold (1980) and Groemping (2007) for the shares.
    """
    shares = dict.fromkeys((*FEATURE_GROUPS, "unexplained"), 0.0)
    index = 0.0
    for i in np.flatnonzero(coordinate_share > 0.01):
        own = _compute_shapley_shares(found, int(i))
        shares = {name: shares[name] + coordinate_share[i] * own[name] for name in shares}
        index += coordinate_share[i] * compute_memory_index(found, int(i))
    total = sum(shares.values())
    if total <= 0.0:
        return ResidualComponents(shares | {"unexplained": 1.0}, 0.0)
    return ResidualComponents({name: float(share / total) for name, share in shares.items()}, float(index))


def compute_explained_share(
    found: ResidualFeatures, coordinate: int, columns: Float64[np.ndarray, "n k"]
) -> float:
    """Share of the residual's square that a ridge regression on ``columns`` predicts on left-out blocks.

    Against zero, not the mean: a constant force is a finding. At least zero; the best of three ridges.
    """
    return _FoldedRegression(found, coordinate, columns).score(np.arange(columns.shape[1]))


def compute_memory_index(found: ResidualFeatures, coordinate: int) -> float:
    """How much better lags predict the residual on left-out blocks than the present alone, in [0, 1].

    By kernel regression, which needs no form of the dependence.
    """
    groups = found.groups[coordinate]
    present = np.concatenate(
        [
            groups["conservative"][:, 1:2],
            groups["dissipative"][:, :1],
            groups["actuation"],
            groups["exogenous"],
        ],
        axis=1,
    )
    wide = np.concatenate([present, groups["memory"]], axis=1)
    return max(
        0.0,
        _score_kernel_regression(found, coordinate, wide)
        - _score_kernel_regression(found, coordinate, present),
    )


class _FoldedRegression:
    """Normal equations of one coordinate's regression, fold by fold."""

    def __init__(self, found: ResidualFeatures, coordinate: int, columns: np.ndarray) -> None:
        weight = found.weight[:, coordinate]
        weight = weight / weight.sum()
        rms = np.sqrt(weight @ columns**2)
        x = np.sqrt(weight)[:, None] * columns / np.where(rms > 0.0, rms, 1.0)
        y = np.sqrt(weight) * found.target[:, coordinate]
        folds = [found.fold == fold for fold in range(RESIDUAL_FEATURES.folds)]
        self.gram = np.stack([x[fold].T @ x[fold] for fold in folds])
        self.moment = np.stack([x[fold].T @ y[fold] for fold in folds])
        self.square = float(y @ y)

    def score(self, chosen: np.ndarray) -> float:
        if not len(chosen) or self.square <= 0.0:
            return 0.0
        gram = self.gram[:, chosen][:, :, chosen]
        moment = self.moment[:, chosen]
        best = 0.0
        for ridge in COMPONENTS.ridges:
            learnt = gram.sum(axis=0) - gram + ridge * np.eye(len(chosen))
            beta = np.linalg.solve(learnt, (moment.sum(axis=0) - moment)[..., None])[..., 0]
            error = np.einsum("fa,fab,fb->", beta, gram, beta) - 2.0 * np.sum(beta * moment)
            best = max(best, float(-error / self.square))
        return best


def _compute_shapley_shares(found: ResidualFeatures, coordinate: int) -> dict[str, float]:
    groups = found.groups[coordinate]
    present = [name for name in FEATURE_GROUPS[:-1] if groups[name].shape[1]]
    sizes = np.cumsum([0, *(groups[name].shape[1] for name in (*present, "memory"))])
    columns = {
        name: np.arange(a, b) for name, a, b in zip((*present, "memory"), sizes[:-1], sizes[1:], strict=True)
    }
    fit = _FoldedRegression(found, coordinate, np.concatenate([groups[name] for name in columns], axis=1))

    def value(names: Sequence[str]) -> float:
        return fit.score(np.concatenate([columns[name] for name in names])) if names else 0.0

    values = {
        frozenset(names): value(names)
        for count in range(len(present) + 1)
        for names in combinations(present, count)
    }
    n = len(present)
    shares = dict.fromkeys(FEATURE_GROUPS, 0.0)
    for name in present:
        others = [other for other in present if other != name]
        for count in range(n):
            factor = factorial(count) * factorial(n - count - 1) / factorial(n)
            for names in combinations(others, count):
                shares[name] += factor * (values[frozenset((*names, name))] - values[frozenset(names)])
    now = values[frozenset(present)]
    shares["memory"] = max(0.0, value((*present, "memory")) - now)
    positive = {name: max(0.0, share) for name, share in shares.items()}
    # A group that only confuses the others has a negative share: the rest must sum to what is explained.
    sum_now = sum(positive[name] for name in present)
    for name in present:
        positive[name] *= now / sum_now if sum_now > 0.0 else 0.0
    return positive | {"unexplained": max(0.0, 1.0 - sum(positive.values()))}


def _score_kernel_regression(found: ResidualFeatures, coordinate: int, columns: np.ndarray) -> float:
    picked = slice(None, None, max(1, int(np.ceil(len(columns) / COMPONENTS.max_samples))))
    x, y = columns[picked], found.target[picked, coordinate]
    spread = np.std(x, axis=0)
    x = (x / np.where(spread > 0.0, spread, 1.0))[:, spread > 0.0]
    scale = np.std(y)
    if not x.shape[1] or scale == 0.0:
        return 0.0
    fold, scores = found.fold[picked], []
    for width in COMPONENTS.width_factors:
        gamma = 0.5 / (width**2 * x.shape[1])
        error = 0.0
        for left_out in range(RESIDUAL_FEATURES.folds):
            test = fold == left_out
            if test.any() and not test.all():
                model = KernelRidge(alpha=1e-3, kernel="rbf", gamma=gamma).fit(x[~test], y[~test] / scale)
                error += float(np.sum((y[test] / scale - model.predict(x[test])) ** 2))
        scores.append(1.0 - error / float(np.sum((y / scale) ** 2)))
    return max(0.0, *scores)


@dataclass(frozen=True)
class ResidualCorrelations:
    """Correlation of each coordinate's residual with its regressors: ``score`` (d, k) is its size over the
    5 % bound, zero where a coordinate has no residual or a regressor does not vary."""

    coordinates: tuple[str, ...]
    regressors: tuple[str, ...]
    score: Float64[np.ndarray, "d k"]


def compute_residual_correlations(
    smoothed: Sequence[LatentForceEstimate], *, q_names: Sequence[str], u_names: Sequence[str]
) -> ResidualCorrelations:
    """Test the residual of ``smoothed`` motions against inputs, their rates, and functions of its own
    coordinate and velocity, and time."""
    lengths = [stop - start for one in smoothed for start, stop in one.motion.segments]
    residual = np.concatenate([one.residual for one in smoothed])
    q, v = (np.concatenate([getattr(one, name) for one in smoothed]) for name in ("q", "v"))
    inputs = _get_input_regressors(smoothed, u_names)
    time_s = np.concatenate([one.motion.time_s for one in smoothed])
    names: tuple[str, ...] = ()
    rows = []
    for i in range(q.shape[1]):
        named = inputs | _compute_coordinate_regressors(q[:, i], v[:, i]) | {"t": time_s}
        names = tuple(named)
        rows.append([_score_correlation(residual[:, i], column, lengths) for column in named.values()])
    return ResidualCorrelations(tuple(q_names), names, np.array(rows))


def _get_input_regressors(
    smoothed: Sequence[LatentForceEstimate], u_names: Sequence[str]
) -> dict[str, np.ndarray]:
    u = np.concatenate([one.motion.u for one in smoothed])
    rates = np.concatenate([compute_input_rates(one) for one in smoothed])
    out = {name: u[:, j] for j, name in enumerate(u_names)}
    return out | {f"d{name}/dt": rates[:, j] for j, name in enumerate(u_names)}


def _compute_coordinate_regressors(q: np.ndarray, v: np.ndarray) -> dict[str, np.ndarray]:
    middle = q - q.mean()
    return {"q": q, "q²": middle**2, "q³": middle**3, "v": v, "sign v": np.sign(v), "|v| v": np.abs(v) * v}


def _score_correlation(residual: np.ndarray, column: np.ndarray, lengths: Sequence[int]) -> float:
    """Size of the correlation of two series of several clips over `COMPONENTS.correlation_z` of its standard
    deviations."""
    first, second = (series - series.mean() for series in (residual, column))
    power = np.sqrt((first @ first) * (second @ second))
    # a constant leaves only what rounding makes of it
    if power <= 1e-12 * len(first) * np.abs(column).max(initial=0.0) * np.abs(residual).max(initial=0.0):
        return 0.0
    parts = zip(*(np.split(series, np.cumsum(lengths)[:-1]) for series in (first, second)), strict=True)
    spread = sum(float(_autocorrelate(a) @ _autocorrelate(b)) for a, b in parts)
    return float(
        abs(first @ second) / (COMPONENTS.correlation_z * np.sqrt(max(spread, np.finfo(float).tiny)))
    )


def _autocorrelate(series: np.ndarray) -> np.ndarray:
    """Sum of products of a series (n,) with itself at every lag (2 n - 1,), over the root of its length."""
    return correlate(series, series, method="fft") / np.sqrt(len(series))
