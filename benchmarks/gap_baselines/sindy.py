"""Sparse regression of the residual on a library of terms, in the weak form, by an ensemble of PySINDy.

Source: Fasel et al., "Ensemble-SINDy", 2022, doi:10.1098/rspa.2021.0904. It cannot hold a delay, play,
hysteresis, creep or a hidden mode.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from pysindy import STLSQ, EnsembleOptimizer

from benchmarks.gap_baselines.case import Case
from benchmarks.gap_baselines.contest import Place, open_contest
from benchmarks.gap_baselines.residual import Weak, compute_residual, compute_weak_form
from benchmarks.gap_baselines.said import Said, weigh
from lagsplat.diagnose.core.config import DiagnoseConfig

MODELS = 100
"""Models of the ensemble, each fitted to stretches drawn with replacement."""
PERIODS = 0.25
"""Length of a stretch, in rms periods of the motion."""
THRESHOLD = 0.01
"""Share of the sim's own acceleration below which a term is left out of a model."""
INCLUDED = 0.8
"""Share of the models in which a term must stand."""
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
class Included:
    """A term of an ensemble: its place, the share of models that hold it, its rms and its coefficients."""

    place: Place
    share: float
    size: float  # median over the models [rms of the sim's own acceleration]
    coefficients: np.ndarray


def ensemble_sindy(case: Case, config: DiagnoseConfig) -> Said:
    """The terms that most models keep, the strongest first; ``none`` if they keep none.

    Raises:
        ValueError: no clip is long enough for a weak form.
    """
    contest = open_contest(case, config)
    residual = compute_residual(contest.model, case.real)
    forms = [compute_weak_form(residual, i, periods=PERIODS) for i in range(case.d)]
    terms = fit_ensembles(forms, residual.scale, case.real[0].q_names, seed=case.seed)
    probability = weigh_terms(terms)
    chosen = choose_terms(terms)
    if not chosen:
        return Said(probability)
    first = chosen[0]
    return Said(
        probability,
        first.place.coordinate,
        first.place.input,
        _parameters(first.place.name, first.coefficients),
        contest.forecast(contest.fit_named([term.place for term in chosen])),
        tuple(dict.fromkeys(t.place.name for t in chosen[1:] if t.place.name != first.place.name)),
    )


def fit_ensembles(
    forms: Sequence[Weak], scale: np.ndarray, q_names: Sequence[str], *, seed: int
) -> list[Included]:
    """All terms of all coordinates, by falling size."""
    np.random.seed(seed % 2**32)  # noqa: NPY002  the library draws from the global generator
    out = []
    for weak, level, coordinate in zip(forms, scale, q_names, strict=True):
        unit = np.sqrt(np.mean(weak.features**2, axis=0))
        sparse = STLSQ(threshold=THRESHOLD, alpha=1e-3, max_iter=20)
        ensemble = EnsembleOptimizer(sparse, bagging=True, n_models=MODELS)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Sparsity parameter is too big")  # no term is an answer
            ensemble.fit(weak.features / unit, weak.rate[:, None] / level)
        drawn = np.array(ensemble.coef_list).reshape(-1, len(weak.terms))
        for k, term in enumerate(weak.terms):
            place = Place(term.name, coordinate, term.input)
            kept, size = float(np.mean(drawn[:, k] != 0.0)), float(np.median(np.abs(drawn[:, k])))
            out.append(Included(place, kept, size, drawn[:, k] * level / unit[k]))
    return sorted(out, key=lambda term: -term.size)


def choose_terms(terms: Sequence[Included]) -> list[Included]:
    """The terms that enough models keep."""
    return [term for term in terms if term.share >= INCLUDED]


def weigh_terms(terms: Sequence[Included]) -> dict[str, float]:
    """Inclusion probabilities as shares of one: of ``none`` that of no term, the rest by squared size."""
    kept = max((term.share for term in terms), default=0.0)
    scores = {"none": np.log(max(1.0 - kept, 1e-3))}
    total = sum(term.size**2 for term in terms)
    for term in terms:
        if term.size > 0.0:
            score = np.log(kept * term.size**2 / total)
            scores[term.place.name] = np.logaddexp(scores.get(term.place.name, -np.inf), score)
    chosen = choose_terms(terms)
    return weigh(scores, chosen[0].place.name if chosen else "none")


def _parameters(name: str, coefficients: np.ndarray) -> dict[str, tuple[float, float, float]]:
    if name not in UNIT:
        return {}
    key, offset, factor = UNIT[name]
    low, middle, high = np.sort(offset + factor * np.percentile(coefficients, [5.0, 50.0, 95.0]))
    return {key: (float(middle), float(low), float(high))}
