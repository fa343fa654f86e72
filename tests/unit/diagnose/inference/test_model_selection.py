"""Evidence: against an integral that is known, and in the order that the truth demands."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from lagsplat.diagnose.effects.base import DisturbanceHints, PlacedEffect, SampleEffect
from lagsplat.diagnose.estimation.multiple_shooting import ShootingFit, choose_windows, eliminate_starts
from lagsplat.diagnose.inference.model_selection import (
    continue_fit,
    lengthen_horizon,
    try_candidate,
)
from lagsplat.diagnose.inference.placement import place_effects
from lagsplat.diagnose.inference.problem import (
    EstimationProblem,
    HypothesisFit,
    compute_log_evidence,
    make_joint_prior,
)
from lagsplat.diagnose.inference.score_test import score_test
from tests.unit.diagnose.toys import contest, film, own, wave

TRIED = (
    "coulomb_friction",
    "quadratic_drag",
    "cubic_stiffness",
    "constant_force",
    "linear_stiffness",
    "input_lag",
)


def offers(one: EstimationProblem, names: tuple[str, ...] = TRIED) -> list[PlacedEffect]:
    hints = [DisturbanceHints((), ())]
    found = place_effects(one.rollout_model, hints, q_names=("q0",), u_names=("u0",), without=())
    return [offer for offer in found if offer.effect.name in names]


def drag(t: float, q: float, v: float, u: float, z: np.ndarray) -> tuple[float, list[float]]:
    """With quadratic drag of 0.25 a unit."""
    return own(q, v, u) - 0.25 * abs(v) * v, []


@pytest.fixture(scope="module")
def dragged() -> EstimationProblem:
    return contest([film(drag, u=wave(), noise=0.005, seconds=16.0)])


@pytest.fixture(scope="module")
def faithful() -> EstimationProblem:
    return contest([film(u=wave(), noise=0.005, seconds=16.0)])


def none_of(one: EstimationProblem) -> HypothesisFit:
    return HypothesisFit((), one.fit((), np.zeros(one.rollout_model.nuisance.size)))


def evidences(one: EstimationProblem) -> dict[str, float]:
    """Over `none`, of every effect that is tried."""
    none = none_of(one)
    leads = score_test(one, (), none.fit, offers(one))
    fits = [continue_fit(one, try_candidate(one, (), [lead], starts=1)) for lead in leads]
    floor = compute_log_evidence(none, one.rollout_model, 1.0)
    return {
        fit.effects[0].effect.name: compute_log_evidence(fit, one.rollout_model, 1.0) - floor for fit in fits
    }


def test_the_true_effect_has_the_most_evidence_and_the_score_test_leads_to_it(
    dragged: EstimationProblem,
) -> None:
    told = evidences(dragged)
    assert max(told, key=lambda name: told[name]) == "quadratic_drag"
    assert told["quadratic_drag"] > 50.0
    lead = score_test(dragged, (), none_of(dragged).fit, offers(dragged))[0]
    assert lead.placed.effect.name == "quadratic_drag"


def test_where_nothing_is_missing_every_effect_costs_evidence(faithful: EstimationProblem) -> None:
    told = evidences(faithful)
    assert set(told) == set(TRIED)
    assert max(told.values()) < 1.5
    assert np.median(list(told.values())) < 0.0


def test_the_amplitude_is_found_to_a_few_hundredths(dragged: EstimationProblem) -> None:
    none = none_of(dragged)
    lead = score_test(dragged, (), none.fit, offers(dragged))[0]
    found = continue_fit(dragged, try_candidate(dragged, (), [lead], starts=1))
    assert lead.placed.to_physical(found.fit.x[None, :1])[0, 0] == pytest.approx(0.25, rel=0.08)
    assert found.fit.misfit / dragged.degrees_of_freedom == pytest.approx(1.0, abs=0.15)


def test_effects_are_tested_where_most_is_left_and_on_few_windows() -> None:
    size = np.random.default_rng(0).permutation(40).astype(float)
    fit = SimpleNamespace(residual=np.sqrt(size)[:, None, None] * np.ones((40, 5, 1)))
    chosen = choose_windows(fit, np.full(40, 5), 12)
    assert len(chosen) == 12
    assert chosen.tolist() == sorted(set(chosen.tolist()))
    assert {int(size.argmax()), int(size.argmin())} <= set(chosen.tolist())
    few = SimpleNamespace(residual=fit.residual[:3])
    assert choose_windows(few, np.full(3, 5), 12).tolist() == [0, 1, 2]


def test_a_fit_that_was_tried_on_some_windows_ends_where_one_of_all_does(dragged: EstimationProblem) -> None:
    none, some = none_of(dragged), np.array([0, 2, 5])
    ends = []
    for windows in (some, None):
        lead = score_test(dragged, (), none.fit, offers(dragged), windows)[0]
        assert lead.name == "quadratic_drag"
        ends.append(continue_fit(dragged, try_candidate(dragged, (), [lead], starts=1, windows=windows)).fit)
    assert ends[0].residual.shape == ends[1].residual.shape
    assert ends[0].x[0] == pytest.approx(ends[1].x[0], rel=1e-3)
    assert ends[0].misfit == pytest.approx(ends[1].misfit, rel=1e-3)


def test_the_best_of_starts_beside_two_fits_is_kept(dragged: EstimationProblem) -> None:
    moved = none_of(dragged).fit
    still = dragged.with_nuisance(dragged.rollout_model.nuisance.freeze()).fit((), np.zeros(len(moved.x)))
    bases = (moved, replace(still, x=np.zeros(len(moved.x))))
    name = "cubic_stiffness"
    rows = [score_test(dragged, (), base, offers(dragged)) for base in bases]
    tests = [next(test for test in row if test.name == name) for row in rows]
    alone = [try_candidate(dragged, (), [test], starts=1).fit.cost for test in tests]
    assert alone[0] != alone[1]
    assert try_candidate(dragged, (), tests, starts=2).fit.cost == min(alone)


def test_evidence_is_the_integral_over_parameters_and_starts_where_all_is_linear() -> None:
    """Differences of evidence between priors, against the density of what the starts cannot reach."""
    rng = np.random.default_rng(0)
    slopes, begun, y = rng.normal(size=(3, 12, 2)), rng.normal(size=(3, 12, 2)), rng.normal(size=(3, 12, 1))
    design, free = slopes.reshape(36, 2), np.zeros((36, 6))
    for w in range(3):
        free[12 * w : 12 * w + 12, 2 * w : 2 * w + 2] = begun[w]
    beyond = np.linalg.svd(free)[0][:, 6:].T  # an orthonormal basis of what no start explains

    def told(deviation: np.ndarray) -> float:
        left = eliminate_starts(y, slopes, begun)
        curvature, log_det = left.curvature, left.log_determinant
        x = np.linalg.solve(curvature + np.diag(deviation**-2.0), left.right)
        residual = (y[..., 0] - slopes @ x - np.einsum("wma,wa->wm", begun, left.follow(x)))[..., None]
        misfit, starts = float((residual**2).sum()), np.zeros((3, 2))
        fit = ShootingFit(x, starts, residual, misfit, 0.0, curvature, log_det, slopes, begun)
        bench = SimpleNamespace(nuisance=SimpleNamespace(deviation=deviation))
        return compute_log_evidence(HypothesisFit((), fit), bench, 1.0)  # type: ignore[arg-type]

    def truth(deviation: np.ndarray) -> float:
        seen = beyond @ design
        covariance = np.eye(30) + seen * deviation**2 @ seen.T
        return float(multivariate_normal(np.zeros(30), covariance).logpdf(beyond @ y.ravel()))

    narrow, wide = np.array([0.05, 0.3]), np.array([2.0, 0.7])
    assert told(wide) - told(narrow) == pytest.approx(truth(wide) - truth(narrow), rel=1e-9)


def test_unknowns_stand_in_the_order_effects_then_uncertainties(faithful: EstimationProblem) -> None:
    chosen = [o for o in offers(faithful) if not isinstance(o.effect, SampleEffect)][:2]
    prior = make_joint_prior(chosen, faithful.rollout_model)
    own_ = [p.prior for o in chosen for p in o.effect.parameters]
    assert prior.mean[: len(own_)].tolist() == [p.mean for p in own_]
    assert prior.lowest[: len(own_)].tolist() == [p.lowest for p in own_]
    assert np.array_equal(prior.deviation[len(own_) :], faithful.rollout_model.nuisance.deviation)
    assert (prior.step > 0.0).all()


def cog(t: float, q: float, v: float, u: float, z: np.ndarray) -> tuple[float, list[float]]:
    """With a ripple of several times the other forces."""
    return own(q, v, u) + 8.0 * np.sin(8.0 * q + 0.5), []


def test_a_fit_that_stays_where_it_starts_arrives_from_short_windows() -> None:
    one = contest([film(cog, u=wave(), noise=0.005, seconds=16.0)])
    zeros = np.zeros(one.rollout_model.nuisance.size)
    none, (cogging,) = one.fit((), zeros), offers(one, ("cogging",))
    horizons = [one, half := one.halve_windows(), half.halve_windows()]
    # the wrong sign, and a wave number a fifth too large
    wave_number = cogging.effect.parameters[2].prior.unknown(1.2 * 8.0 * cogging.scales.coordinate)
    poor = np.concatenate([[-0.2, -0.4, wave_number], zeros])
    direct = one.fit((cogging,), poor)
    begun = lengthen_horizon(horizons, HypothesisFit((cogging,), replace(none, x=poor)))
    found = continue_fit(one, begun).fit
    assert direct.misfit / one.degrees_of_freedom > 100.0
    assert found.misfit / one.degrees_of_freedom == pytest.approx(1.0, abs=0.2)
    cosine, sine, wave_number = cogging.to_physical(found.x[None, :3])[0]
    assert (np.hypot(cosine, sine), wave_number) == pytest.approx((8.0, 8.0), rel=0.02)
