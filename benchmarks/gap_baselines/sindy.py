"""Sparse regression of the residual on a library of terms, in the weak form, by PySINDy.

Sources: Messenger and Bortz, "Weak SINDy", 2021, doi:10.1137/20M1343166; Fasel et al., "Ensemble-SINDy",
2022, doi:10.1098/rspa.2021.0904. Neither can hold a delay, play, hysteresis, creep or a hidden mode.
"""

from dataclasses import dataclass
from itertools import compress

import numpy as np
from pysindy import FROLS, STLSQ, EnsembleOptimizer, IdentityLibrary, WeakPDELibrary

from benchmarks.gap_baselines.case import Case
from benchmarks.gap_baselines.residual import Residual, Term, residual_of
from benchmarks.gap_baselines.said import Said
from lagsplat.diagnose.core.config import DiagnoseConfig

MODELS = 50
THRESHOLD = 0.02
"""Share of the sim's own acceleration below which a term is left out."""
INCLUDED = 0.6
"""Share of an ensemble's models in which a term must stand."""
UNIT = {
    "viscous_damping": ("rate", 0.0, -1.0),
    "quadratic_drag": ("coefficient", 0.0, -1.0),
    "coulomb_friction": ("acceleration", 0.0, -1.0),
    "linear_stiffness": ("ratio", 1.0, 1.0),
    "cubic_stiffness": ("coefficient", 0.0, -1.0),
    "constant_force": ("acceleration", 0.0, 1.0),
    "mass_change": ("ratio", 1.0, -1.0),
    "input_gain": ("ratio", 1.0, 1.0),
    "input_lag": ("time_constant", 0.0, -1.0),
}
"""Published parameter of a term and how it follows from the coefficient: offset and factor."""


@dataclass(frozen=True)
class Weak:
    """Integrals (K, n) of the terms of one coordinate against test functions, and the rate's own (K,)."""

    terms: tuple[Term, ...]
    features: np.ndarray
    rate: np.ndarray


def weak_form(residual: Residual, i: int) -> Weak:
    """Integrals of coordinate ``i`` over stretches of half a period, in units of the sim's acceleration.

    PySINDy draws the stretches from NumPy's global generator. A term that is zero in all of them, such as
    an input that moves once, has no coefficient and is left out.
    """
    terms = residual.terms[i]
    values = np.stack([term.values for term in terms], axis=1)
    features, rates = [], []
    for start, stop in residual.clips:
        time = residual.time_s[start:stop]
        span = time[-1] - time[0]
        half = min(0.25 * residual.period_s, 0.2 * span)
        if stop - start < 20 or half < 3.0 * span / (stop - start):
            continue
        number = int(np.clip(2.0 * span / half, 10, 400))
        library = WeakPDELibrary(
            IdentityLibrary(), spatiotemporal_grid=time, H_xt=half, K=number, include_bias=False
        )
        x, w = values[start:stop], residual.speed[start:stop, i : i + 1]
        features.append(np.asarray(library.fit([x]).transform([x])[0]))
        rates.append(np.asarray(library.convert_u_dot_integral(w))[:, 0])
    if not features:
        raise ValueError("no clip is long enough for a weak form; record longer")
    all_features = np.concatenate(features)
    excited = np.linalg.norm(all_features, axis=0) > 0.0
    return Weak(tuple(compress(terms, excited)), all_features[:, excited], np.concatenate(rates))


def weak_forms(case: Case, config: DiagnoseConfig) -> tuple[Residual, list[Weak]]:
    """The weak form of every coordinate; the same recording always draws the same stretches."""
    np.random.seed(case.seed % 2**32)  # noqa: NPY002  the library draws from the global generator
    residual = residual_of(case, config)
    return residual, [weak_form(residual, i) for i in range(case.d)]


def weak_sindy(case: Case, config: DiagnoseConfig) -> Said:
    """The one term that takes away most of the residual; it always names one."""
    residual, forms = weak_forms(case, config)
    best: tuple[float, str | None, str | None, str] = (-1.0, None, None, "")
    shares: dict[str, float] = {}
    for i, weak in enumerate(forms):
        unit = np.sqrt(np.mean(weak.features**2, axis=0))
        x, y = weak.features / unit, weak.rate / residual.scale[i]
        chosen = FROLS(normalize_columns=True, max_iter=1, alpha=0.0).fit(x, y[:, None]).coef_[0]
        fit = (x.T @ y) ** 2 / (x**2).sum(axis=0)
        for term, gain in zip(weak.terms, fit, strict=True):
            shares[term.name] = max(shares.get(term.name, 0.0), float(gain))
        k = int(np.argmax(np.abs(chosen)))
        if fit[k] > best[0]:
            best = (float(fit[k]), f"q{i}", weak.terms[k].input, weak.terms[k].name)
    shares[best[3]] = 1.0001 * max(shares.values())
    total = sum(shares.values())
    return Said({name: share / total for name, share in shares.items()}, best[1], best[2])


def ensemble_sindy(case: Case, config: DiagnoseConfig) -> Said:
    """The strongest of the terms that most models of a bagged ensemble keep; ``none`` if they keep none."""
    residual, forms = weak_forms(case, config)
    found: list[tuple[float, str, str, str | None, np.ndarray]] = []
    for i, weak in enumerate(forms):
        unit = np.sqrt(np.mean(weak.features**2, axis=0))
        level = residual.scale[i] * np.sqrt(np.mean(_window(weak) ** 2))
        sparse = STLSQ(threshold=THRESHOLD, alpha=1e-3, max_iter=20)
        ensemble = EnsembleOptimizer(sparse, bagging=True, n_models=MODELS)
        ensemble.fit(weak.features / unit, weak.rate[:, None] / level)
        drawn = np.array(ensemble.coef_list).reshape(-1, len(weak.terms))
        kept = np.mean(drawn != 0.0, axis=0)
        for k in np.flatnonzero(kept >= INCLUDED):
            size = float(np.median(np.abs(drawn[:, k]))) * float(kept[k])
            term = weak.terms[k]
            found.append((size, term.name, f"q{i}", term.input, drawn[:, k] * level / unit[k]))
    if not found:
        return Said({"none": 1.0})
    found.sort(key=lambda row: -row[0])
    shares: dict[str, float] = {}
    for size, name, *_ in found:
        shares[name] = shares.get(name, 0.0) + size**2
    total = sum(shares.values())
    _, first, coordinate, channel, coefficients = found[0]
    shares = {name: share / total for name, share in shares.items()}
    shares[first] = max(shares.values())
    total = sum(shares.values())
    return Said(
        {name: share / total for name, share in shares.items()},
        coordinate,
        channel,
        _parameters(first, coefficients),
    )


def _window(weak: Weak) -> np.ndarray:
    """Integrals of a constant force of one: how much a unit of acceleration counts in each stretch."""
    return weak.features[:, next(k for k, t in enumerate(weak.terms) if t.name == "constant_force")]


def _parameters(name: str, coefficients: np.ndarray) -> dict[str, tuple[float, float, float]]:
    if name not in UNIT:
        return {}
    key, offset, factor = UNIT[name]
    low, middle, high = np.sort(offset + factor * np.percentile(coefficients, [5.0, 50.0, 95.0]))
    return {key: (float(middle), float(low), float(high))}
