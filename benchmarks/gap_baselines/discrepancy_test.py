"""Regress the residual on a library, test every term, and control the rate of false discoveries.

In the manner of LISDD (Wang, "Where Is My Physics Wrong?", 2026, arXiv:2606.23215): a coordinate is suspect
where its residual has more energy than on the sim's own recordings, the clean regime; a term is named where
an F-test finds it significant, and tests of many terms are corrected after Benjamini and Hochberg, 1995,
doi:10.1111/j.2517-6161.1995.tb02031.x. As in E-SINDy, a delay, play, hysteresis, creep or a hidden mode is no
term.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import f as f_distribution
from scipy.stats import false_discovery_control

from benchmarks.gap_baselines.case import Case
from benchmarks.gap_baselines.contest import Place, open_contest
from benchmarks.gap_baselines.residual import Weak, compute_residual, compute_weak_form
from benchmarks.gap_baselines.said import Said, weigh
from lagsplat.diagnose.core.config import DiagnoseConfig
from lagsplat.diagnose.estimation.multiple_shooting import compute_autocorrelation_time

FALSE_DISCOVERIES = 0.05
"""Expected share of false ones among the terms that are named."""
PERIODS = 0.25
"""Length of a stretch, in rms periods of the motion."""
SHARE = 0.006
"""Share of the sim's own acceleration that a term must make up."""
MOST = 2
"""Terms that are named at most."""


@dataclass(frozen=True)
class Test:
    """F-test of one term of a coordinate beside the terms chosen so far."""

    coordinate: int
    term: int
    p: float
    log_likelihood: float
    size: float  # rms of the term [rms of the sim's own acceleration]


def discrepancy_test(case: Case, config: DiagnoseConfig) -> Said:
    """The significant terms, the largest F first; ``unknown`` where a suspect coordinate has none.

    Raises:
        ValueError: no clip is long enough for a weak form.
    """
    contest = open_contest(case, config)
    real, own = (compute_residual(contest.model, motions) for motions in (case.real, case.sim))
    forms, clean = (
        [compute_weak_form(each, i, periods=PERIODS) for i in range(case.d)] for each in (real, own)
    )
    suspect = find_suspects(forms, clean)
    chosen, tests = choose_terms(forms, suspect, real.scale)
    scores = {"none": 0.0}
    for test in tests:
        name = forms[test.coordinate].terms[test.term].name
        scores[name] = max(scores.get(name, 0.0), test.log_likelihood)
    if not chosen:
        first = "unknown" if suspect else "none"
        return Said(weigh({first: 0.0, **scores}, first))
    named = []
    for test in chosen:
        term = forms[test.coordinate].terms[test.term]
        named.append(Place(term.name, case.real[0].q_names[test.coordinate], term.input))
    others = tuple(dict.fromkeys(place.name for place in named[1:] if place.name != named[0].name))
    return Said(
        weigh(scores, named[0].name),
        named[0].coordinate,
        named[0].input,
        blocks=contest.forecast(contest.fit_named(named)),
        others=others,
    )


def find_suspects(forms: Sequence[Weak], clean: Sequence[Weak]) -> list[int]:
    """The coordinates whose residual has significantly more energy than on the sim's own recordings."""
    p = []
    for weak, own in zip(forms, clean, strict=True):
        ratio = float(np.mean(weak.rate**2) / np.mean(own.rate**2))
        p.append(float(f_distribution.sf(ratio, count_samples(weak.rate), count_samples(own.rate))))
    return np.flatnonzero(false_discovery_control(p) <= FALSE_DISCOVERIES).tolist()


def choose_terms(
    forms: Sequence[Weak], suspect: Sequence[int], scale: np.ndarray
) -> tuple[list[Test], list[Test]]:
    """The terms that are named, one after another, and the tests of all terms alone."""
    chosen: list[Test] = []
    first: list[Test] = []
    while len(chosen) < MOST:
        tests = [
            test
            for i in suspect
            for test in test_terms(forms[i], i, [t.term for t in chosen if t.coordinate == i], scale[i])
        ]
        first = first or tests
        if not tests:
            break
        corrected = false_discovery_control([test.p for test in tests])
        kept = [
            test
            for test, p in zip(tests, corrected, strict=True)
            if p <= FALSE_DISCOVERIES and test.size >= SHARE
        ]
        if not kept:
            break
        chosen.append(max(kept, key=lambda test: test.log_likelihood))
    return chosen, first


def test_terms(weak: Weak, coordinate: int, known: Sequence[int], scale: float) -> list[Test]:
    """F-tests of every term that is not among the ``known`` ones, each beside these."""
    x, y = weak.features, weak.rate
    before, _ = _fit(x[:, list(known)], y)
    out = []
    for k in range(x.shape[1]):
        if k in known:
            continue
        after, coefficients = _fit(x[:, [*known, k]], y)
        n = count_samples(after)
        freedom = n - len(known) - 1.0
        if freedom < 1.0:
            continue
        ratio = float(before @ before) / max(float(after @ after), 1e-300)
        p = float(f_distribution.sf((ratio - 1.0) * freedom, 1.0, freedom))
        size = abs(coefficients[-1]) * float(np.sqrt(np.mean(x[:, k] ** 2))) / scale
        out.append(Test(coordinate, k, p, 0.5 * n * float(np.log(ratio)), size))
    return out


def count_samples(residual: np.ndarray) -> float:
    """Independent samples in a residual (K,), whose stretches overlap and whose errors last."""
    return len(residual) / compute_autocorrelation_time(residual[None, :, None], np.array([len(residual)]))


def _fit(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residual and coefficients of least squares."""
    unit = np.sqrt(np.mean(x**2, axis=0))
    coefficients = np.linalg.lstsq(x / unit, y, rcond=None)[0] / unit
    return y - x @ coefficients, coefficients
