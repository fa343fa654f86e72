"""Measures of alternatives: the right effect explains, forecasts and has evidence; others do less."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.calibration.measure import leave_out_effects
from lagsplat.diagnose.core.config import PROBLEM
from lagsplat.diagnose.estimation.multiple_shooting import compute_autocorrelation_time
from lagsplat.diagnose.inference.effect_search import EffectSearch, search_effects
from lagsplat.diagnose.inference.model_selection import SearchBudget
from lagsplat.diagnose.inference.placement import find_hints, place_effects
from lagsplat.diagnose.inference.problem import EstimationProblem
from lagsplat.diagnose.verdict.alternatives import (
    Measures,
    _compute_gain_z,
    estimate_noise_level,
    measure_alternatives,
)
from tests.unit.diagnose.toys import contest, film, oscillator, own, settings, wave
from tests.unit.diagnose.verdict.made_alternatives import NONE, alternatives, effect

RIVALS = ("quadratic_drag", "coulomb_friction", "cubic_stiffness", "time_jitter")


def drag(t: float, q: float, v: float, u: float, z: np.ndarray) -> tuple[float, list[float]]:
    return own(q, v, u) - 0.25 * abs(v) * v, []


REAL = film(drag, u=wave(), noise=0.005, seconds=16.0)


def search(problem: EstimationProblem) -> EffectSearch:
    hints = find_hints(oscillator(), [REAL], period_s=problem.period_s, hold="linear")
    every = place_effects(problem.rollout_model, hints, q_names=("q0",), u_names=("u0",), without=())
    tried = [candidate for candidate in every if candidate.effect.name in RIVALS]
    config = replace(settings(), always_fitted=["coulomb_friction"], places=1, starts=1)
    return search_effects(problem, tried, SearchBudget(config, 1.0))


@pytest.fixture(scope="module")
def searched() -> EffectSearch:
    return search(contest([REAL]))


def measure(found: EffectSearch) -> dict[tuple[str, ...], Measures]:
    return {m.names: m for m in measure_alternatives(found).measures}


def test_the_right_effect_explains_forecasts_and_has_the_most_evidence(searched: EffectSearch) -> None:
    found = measure(searched)
    none, right = found[()], found["quadratic_drag",]
    assert none.log_evidence == none.gain_z == 0.0
    assert none.error > 2.0 * none.floor
    assert right.error == pytest.approx(right.floor, rel=0.25)
    assert right.misfit == pytest.approx(1.0, abs=0.2)
    assert right.log_evidence > 50.0
    assert right.log_evidence == max(m.log_evidence for m in found.values())
    assert right.gain_z > 2.0
    assert (right.parameters, right.single_samples, right.recurrence) == (1, False, 1.0)
    assert found["time_jitter",].single_samples


def test_without_the_right_effect_the_rest_explains_less(searched: EffectSearch) -> None:
    left = measure(leave_out_effects(searched, ["quadratic_drag"]))
    assert not any("quadratic_drag" in names for names in left)
    assert set(RIVALS) - {"quadratic_drag"} <= {name for names in left for name in names}
    single = min(m.misfit for names, m in left.items() if len(names) == 1)
    assert single > 1.3


def test_noise_that_was_taken_for_too_large_is_not_evidence_lost(searched: EffectSearch) -> None:
    loud = measure(search(replace(searched.problem, sigma=2.0 * searched.problem.sigma)))
    right, known = (found["quadratic_drag",] for found in (loud, measure(searched)))
    assert right.misfit == pytest.approx(known.misfit / 4.0, rel=0.05)
    assert right.log_evidence == pytest.approx(known.log_evidence, rel=0.2)
    assert right.floor == pytest.approx(known.floor, rel=0.2)


def test_the_noise_is_no_more_than_what_the_best_leaves() -> None:
    assert estimate_noise_level(1.0, 1.4, 0.05) == 1.0
    assert estimate_noise_level(1.0, 0.25, 0.05) == pytest.approx(0.275)
    assert estimate_noise_level(3.0, 0.25, 0.05) == 3.0


def test_the_best_has_the_most_evidence_and_the_best_single_stands_alone() -> None:
    pair = effect("creep", "input_lag", log_evidence=400.0, misfit=2.0, error=0.5)
    alone = effect("creep", log_evidence=200.0, misfit=3.0, error=0.011)
    weak = effect("input_lag", log_evidence=-9.0, misfit=4.0)
    made = alternatives(weak, alone, pair)
    assert made.best is pair
    assert made.best_single is alone
    assert (made.least_misfit, made.least_error) == (2.0, 0.011)
    assert alternatives().best is NONE
    assert alternatives().best_single is None
    assert alternatives(weak).best is NONE


@pytest.mark.parametrize(("misfit", "explained"), [(60.0, True), (60.1, False)])
def test_a_share_of_the_motion_is_explained_or_nothing_is(
    monkeypatch, misfit: float, explained: bool
) -> None:
    monkeypatch.setattr(PROBLEM, "min_explained_share", 0.4)
    made = alternatives(effect("creep", misfit=misfit), none=replace(NONE, misfit=90.0))
    assert replace(made, motionless=100.0).explained is explained


@pytest.mark.parametrize(
    ("before", "after", "z"),
    [
        ([np.e, np.e**3], [1.0, 1.0], 2.0 / (np.sqrt(2.0) / np.sqrt(2.0))),  # drops of 1 and 3
        ([1.0, 1.0], [np.e, np.e**3], -2.0),
        ([np.e, np.e**2, np.e**3], [1.0, 1.0, 1.0], 2.0 * np.sqrt(3.0)),  # their deviation is 1
        ([np.e], [1.0], 0.0),
        ([np.e, np.e], [1.0, 1.0], 0.0),
        ([1.0, 0.0], [1.0, 0.0], 0.0),
    ],
)
def test_a_gain_is_the_mean_drop_of_the_logarithm_in_standard_errors(before, after, z) -> None:
    assert _compute_gain_z(np.array(before), np.array(after)) == pytest.approx(z)


def test_the_noise_level_is_the_nominal_one_from_the_noise_upwards() -> None:
    assert estimate_noise_level(1.0001, 0.1, 0.05) == 1.0001
    assert estimate_noise_level(0.5, 0.95, 0.05) == 1.0


def test_measures_are_those_of_the_fits(searched: EffectSearch) -> None:
    """What a measure says is worked out again from the fit that it is of."""
    made, problem = measure_alternatives(searched), searched.problem
    freedom = problem.degrees_of_freedom
    assert made.motionless == problem.motionless_misfit
    assert made.chance == pytest.approx(np.sqrt(2.0 * searched.budget.effective_sample_ratio / freedom))
    assert made.nominal == 1.0
    assert len(made.fits) == len(made.measures)
    assert made.fits[0] is searched.ranking.none
    for fit, m in zip(made.fits, made.measures, strict=True):
        assert m.names == tuple(sorted(placed.effect.name for placed in fit.effects))
        assert m.misfit == pytest.approx(fit.fit.misfit / freedom)
        assert m.parameters == fit.n_effect_parameters
        # of an exact sim: what correlates is missing
        correlated = compute_autocorrelation_time(fit.fit.residual, problem.windows.length)
        assert m.memory == pytest.approx(max(correlated, 1.0))
        priors = [p.prior for placed in fit.fitted for p in placed.effect.parameters]
        away = [(x - p.mean) / p.deviation for x, p in zip(fit.fit.x, priors, strict=False)]
        assert m.surprise == pytest.approx(sum(x * x for x in away))
    assert made.measures[0].memory > 1.5
    names = [m.names for m in made.measures]
    assert len(set(names)) == len(names)
    assert made.relaxed_log_evidence < made.best.log_evidence  # a relaxed sim is no drag


def test_evidence_for_effects_is_less_by_what_the_errors_of_the_sim_pass_for(searched: EffectSearch) -> None:
    budget = replace(searched.budget, log_evidence_offset=7.0)
    found, less = measure(searched), measure(replace(searched, budget=budget))
    assert less["quadratic_drag",].log_evidence == pytest.approx(found["quadratic_drag",].log_evidence - 7.0)
    assert less[()].log_evidence == 0.0
    assert less["time_jitter",].log_evidence == found["time_jitter",].log_evidence


def test_where_nothing_can_be_held_out_errors_are_those_of_the_fits() -> None:
    short = film(drag, u=wave(), noise=0.02, seconds=1.2)
    searched = search(contest([short]))
    assert len(searched.problem.windows.first) == 1
    made, noise = measure_alternatives(searched), float(searched.problem.sigma[0])
    for m in made.measures:
        assert m.floor == pytest.approx(noise / np.std(short.q) * np.sqrt(made.nominal))
        assert m.error / m.floor == pytest.approx(np.sqrt(m.misfit / made.nominal))
        assert m.gain_z == 0.0  # of a single block


def test_fewer_independent_samples_are_less_evidence_in_proportion(searched: EffectSearch) -> None:
    budget = searched.budget
    fewer = replace(searched, budget=replace(budget, correlation=4.0 * budget.effective_sample_ratio))
    whole, fourth = (measure(found)["quadratic_drag",].log_evidence for found in (searched, fewer))
    # the level of the noise, which chance widens, is another as well
    assert whole / 5.0 < fourth < whole / 2.5
