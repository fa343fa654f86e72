"""Measures of alternatives: the right effect explains, forecasts and has evidence; others do less."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.calibration.measure import leave_out_effects
from lagsplat.diagnose.inference.effect_search import EffectSearch, search_effects
from lagsplat.diagnose.inference.model_selection import SearchBudget
from lagsplat.diagnose.inference.placement import find_hints, place_effects
from lagsplat.diagnose.inference.problem import EstimationProblem
from lagsplat.diagnose.verdict.alternatives import Measures, estimate_noise_level, measure_alternatives
from tests.unit.diagnose.toys import contest, film, oscillator, own, settings, wave

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
