"""A gap that nothing explains must not be made up for by moving all that is believed of the sim."""

from dataclasses import replace

import numpy as np
import pytest

from lagsplat.diagnose.estimation.multiple_shooting import compute_autocorrelation_time
from lagsplat.diagnose.inference.effect_search import inflate_noise
from lagsplat.diagnose.inference.model_selection import SearchBudget
from lagsplat.diagnose.inference.problem import EstimationProblem, HypothesisFit
from tests.unit.diagnose.toys import contest, film, own, settings, wave


def strange(t: float, q: float, v: float, u: float, z: np.ndarray) -> tuple[float, list[float]]:
    """A damping that depends on where it is, which the catalogue lacks."""
    return own(q, v, u) - 4.0 * np.cos(5.0 * q) * v, []


def plain(one: EstimationProblem) -> HypothesisFit:
    return HypothesisFit((), one.fit((), np.zeros(one.rollout_model.nuisance.size)))


@pytest.fixture(scope="module")
def odd() -> EstimationProblem:
    return contest([film(strange, u=wave(), noise=0.001, seconds=16.0)])


def test_what_is_left_counts_as_noise_where_nothing_explains(odd: EstimationProblem) -> None:
    effort = SearchBudget(settings(), nominal=1.0)
    none = plain(odd)
    wide = inflate_noise(odd, effort, none)
    assert wide is not None
    dear, effort_there = wide
    each = [(row[:n] ** 2).mean() for row, n in zip(none.fit.residual, odd.windows.length, strict=True)]
    left, alike = np.median(each), compute_autocorrelation_time(none.fit.residual, odd.windows.length)
    assert left > 100.0
    assert dear.noise_inflation == pytest.approx(left * alike)
    assert effort_there.effective_sample_ratio == pytest.approx(max(effort.effective_sample_ratio, alike))
    deviation = odd.rollout_model.nuisance.deviation

    def far(one: HypothesisFit) -> float:
        return float(np.abs(one.fit.x / deviation).max())

    there = plain(dear)
    assert far(there) < 0.3 * far(none)
    assert there.fit.misfit > none.fit.misfit


def test_near_the_noise_nothing_changes() -> None:
    quiet = contest([film(u=wave(), noise=0.01, seconds=8.0)])
    assert inflate_noise(quiet, SearchBudget(settings(), nominal=1.0), plain(quiet)) is None


def test_a_sim_that_misses_its_own_recordings_is_not_asked_for_more(odd: EstimationProblem) -> None:
    none = plain(odd)
    assert (
        inflate_noise(odd, SearchBudget(settings(), nominal=none.fit.misfit / odd.degrees_of_freedom), none)
        is None
    )


def test_a_push_in_one_stretch_says_nothing_of_the_law() -> None:
    """What the law leaves is that of the middle stretch."""
    quiet = contest([film(u=wave(), noise=0.01, seconds=16.0)])
    none = plain(quiet)
    residual = none.fit.residual.copy()
    residual[2] *= 30.0
    loud = replace(none, fit=replace(none.fit, residual=residual, misfit=float((residual**2).sum())))
    assert loud.fit.misfit > 10.0 * quiet.degrees_of_freedom
    assert inflate_noise(quiet, SearchBudget(settings(), nominal=1.0), loud) is None
