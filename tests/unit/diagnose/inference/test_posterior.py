"""From evidence that is made up to probabilities and a verdict."""

from dataclasses import replace

import numpy as np
import pytest

from lagsplat.diagnose.core.config import VERDICT
from lagsplat.diagnose.effects.base import PlacedEffect
from lagsplat.diagnose.effects.parameters import Scales
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.diagnose.estimation.multiple_shooting import GaussianPrior, ShootingFit
from lagsplat.diagnose.inference.model_selection import ModelRanking
from lagsplat.diagnose.inference.posterior import (
    GapMeasure,
    Implausibility,
    find_equivalent_effects,
    judge_hypotheses,
    log_posteriors,
)
from lagsplat.diagnose.inference.problem import HypothesisFit
from lagsplat.diagnose.inference.profile_likelihood import compute_laplace_interval
from tests.unit.diagnose.toys import settings

FREEDOM = 1000.0
UNIT = Scales(1.0, 1.0, 1.0, 0.02, 10.0)


def fitted(misfit: float, k: int = 0) -> ShootingFit:
    empty = np.zeros((1, 1, 1))
    return ShootingFit(
        np.zeros(k), np.zeros((1, 2)), empty, misfit * FREEDOM, 0.0, np.eye(k), 0.0, 1, empty[..., :0], empty
    )


def one(name: str, evidence: float, misfit: float = 1.0, *others: str) -> HypothesisFit:
    effects = tuple(PlacedEffect(catalogue()[other], UNIT) for other in (*others, name))
    unknowns = sum(len(effect.effect.parameters) for effect in effects)
    return HypothesisFit(effects, fitted(misfit, unknowns), evidence)


def ranking(*found: HypothesisFit, none: float) -> ModelRanking:
    ordered = sorted(found, key=lambda row: -row.log_evidence)
    return ModelRanking(HypothesisFit((), fitted(none), 0.0), tuple(ordered), 2.0)


def told(rows: ModelRanking, *chain: HypothesisFit):  # the judgement under the usual settings
    return judge_hypotheses(rows, chain, GapMeasure(FREEDOM, 1.0, settings()))


def test_a_gap_that_one_effect_explains_is_that_effect() -> None:
    best, other = one("coulomb_friction", 400.0), one("hysteresis", 350.0, 1.2)
    said = told(ranking(best, other, none=3.0), best)
    assert said.verdict == "effect"
    assert next(iter(said.probabilities)) == "coulomb_friction"
    assert said.best is best
    assert said.unexplained == pytest.approx(0.0, abs=1e-9)


def test_no_gap_is_none_whatever_little_an_effect_gains() -> None:
    weak = one("coulomb_friction", 0.5, 0.999)
    said = told(ranking(weak, none=1.0), weak)
    assert said.verdict == "none"
    assert told(ranking(one("creep", -3.0), none=1.0)).verdict == "none"


def test_a_gap_that_nothing_explains_is_unknown() -> None:
    poor = one("coulomb_friction", 900.0, 6.0)
    said = told(ranking(poor, none=10.0), poor)
    assert said.verdict == "unknown"
    assert said.unexplained == pytest.approx(5.0 / 9.0)
    assert told(ranking(one("creep", -3.0, 10.0), none=10.0)).verdict == "unknown"


def test_a_sim_that_runs_off_misses_no_more_than_one_that_stands_still() -> None:
    """Whatever keeps it near explains nearly all of a gap of 1e12, and next to nothing of the motion."""
    push = one("external_push", 900.0, 9000.0)
    rows = ranking(push, none=1e12)
    assert told(rows, push).verdict == "effect"
    within = judge_hypotheses(rows, (push,), GapMeasure(FREEDOM, 1.0, settings()), most=10000.0)
    assert within.verdict == "unknown"
    assert within.unexplained == pytest.approx(0.9, abs=0.01)


def test_creep_that_never_comes_to_rest_is_a_spring() -> None:
    """As evident as a stiffness, it is as likely; not so if it takes as long as the recording."""
    spring, creep = one("linear_stiffness", 90.0), one("creep", 90.0)
    alike = log_posteriors(ranking(spring, creep, none=3.0), settings())
    assert alike["creep"] == pytest.approx(alike["linear_stiffness"])
    slow = np.array([0.0, creep.effects[0].effect.parameters[1].prior.unknown(8.0)])
    late = replace(creep, fit=replace(creep.fit, x=slow))
    told = log_posteriors(ranking(spring, late, none=3.0), settings())
    assert told["creep"] < told["linear_stiffness"] - 3.0


def test_unknown_grows_with_what_is_left() -> None:
    shares = []
    for misfit in (1.0, 1.3, 2.0, 4.0, 8.0):
        best = one("coulomb_friction", 900.0, misfit)
        shares.append(told(ranking(best, none=10.0), best).probabilities["unknown"])
    assert shares == sorted(shares)
    assert shares[0] < 0.1
    assert shares[-1] > 0.9


def test_what_an_effect_pushes_into_the_sims_own_uncertainties_is_left_unexplained() -> None:
    best = one("coulomb_friction", 400.0)
    within = replace(best, fit=replace(best.fit, penalty=70.0))
    beyond = replace(best, fit=replace(best.fit, penalty=1500.0))
    assert told(ranking(within, none=3.0), within).verdict == "effect"
    said = told(ranking(beyond, none=3.0), beyond)
    assert said.verdict == "unknown"
    assert said.unexplained == pytest.approx((1.5 - 0.08) / 2.0)


def test_no_effect_and_a_sim_moved_beyond_belief_is_unknown() -> None:
    rows = ranking(one("creep", -3.0), none=1.0)
    assert told(rows).verdict == "none"
    pushed = replace(rows, none=replace(rows.none, fit=replace(rows.none.fit, penalty=400.0)))
    assert told(pushed).verdict == "unknown"


def test_doubt_in_the_best_explanation_or_in_none_speaks_for_unknown() -> None:
    best = one("coulomb_friction", 400.0)
    said = judge_hypotheses(
        ranking(best, none=3.0),
        [best],
        GapMeasure(FREEDOM, 1.0, settings()),
        doubt=lambda one: Implausibility(0.8, "loose"),
    )
    assert (said.verdict, said.implausibility) == ("unknown", "loose")
    assert said.probabilities["unknown"] == pytest.approx(0.8, abs=0.02)
    nothing = ranking(one("creep", -3.0), none=1.0)
    asked = []
    said = judge_hypotheses(
        nothing,
        [],
        GapMeasure(FREEDOM, 1.0, settings()),
        doubt=lambda one: asked.append(one) or Implausibility(0.9, "loose"),
    )
    assert said.verdict == "unknown"
    assert asked == [nothing.none]


def test_a_set_that_explains_what_no_single_one_does_is_named_whole() -> None:
    single = one("coulomb_friction", 500.0, 4.0)
    pair = one("input_lag", 900.0, 1.0, "coulomb_friction")
    said = told(ranking(single, one("creep", 480.0, 4.2), none=10.0), single, pair)
    assert said.verdict == "effect"
    assert said.best is pair
    assert set(list(said.probabilities)[:2]) == {"coulomb_friction", "input_lag"}


def test_a_set_that_still_leaves_much_is_not_believed() -> None:
    single = one("coulomb_friction", 500.0, 6.0)
    pair = one("input_lag", 700.0, 3.0, "coulomb_friction")
    said = told(ranking(single, none=10.0), single, pair)
    assert said.best is single
    assert said.verdict == "unknown"


def test_probabilities_are_a_distribution_over_the_catalogue_none_and_unknown() -> None:
    best = one("coulomb_friction", 1e4)
    probabilities = told(ranking(best, none=30.0), best).probabilities
    assert sum(probabilities.values()) == pytest.approx(1.0)
    assert set(probabilities) == {*catalogue(), "none", "unknown"}
    assert min(probabilities.values()) > 0.0
    assert max(probabilities.values()) <= VERDICT.max_probability
    assert list(probabilities.values()) == sorted(probabilities.values(), reverse=True)


def test_what_is_left_out_of_the_catalogue_gets_no_probability() -> None:
    config = replace(settings(), without=["creep"])
    best = one("coulomb_friction", 50.0)
    said = judge_hypotheses(ranking(best, none=2.0), [best], GapMeasure(FREEDOM, 1.0, config))
    assert "creep" not in said.probabilities


def test_the_same_effect_at_many_places_is_not_the_likelier_for_it() -> None:
    many = [one("coulomb_friction", 50.0 - 0.01 * i) for i in range(4)]
    few = one("creep", 49.5)
    said = told(ranking(*many, few, none=2.0), many[0])
    assert said.probabilities["creep"] > said.probabilities["coulomb_friction"]


def test_what_evidence_cannot_separate_is_reported_as_a_class() -> None:
    delay, lag, gain = one("input_delay", 80.0), one("input_lag", 76.0), one("creep", 75.0)
    assert find_equivalent_effects(ranking(delay, lag, gain, none=3.0)) == (("input_delay", "input_lag"),)
    assert find_equivalent_effects(ranking(delay, one("input_lag", 60.0), none=3.0)) == ()
    assert find_equivalent_effects(ranking(delay, one("creep", 78.5), none=3.0)) == (
        ("input_delay", "creep"),
    )
    assert find_equivalent_effects(ranking(one("input_delay", -1.0), none=1.0)) == ()


def test_intervals_are_laplaces_made_wider_and_respect_the_bound() -> None:
    fit = replace(fitted(1.0, 3), x=np.array([0.1, 2.0, 0.0]), curvature=np.diag([400.0, 100.0, 1.0]))
    low, high = compute_laplace_interval(
        HypothesisFit((PlacedEffect(catalogue()["external_periodic_force"], UNIT),), fit),
        GaussianPrior(np.zeros(3), np.full(3, 1e3), np.array([0.0, -np.inf, -np.inf]), np.ones(3)),
        noise_inflation=4.0,
    )
    near, far = (
        1.645 * (VERDICT.deviation_factor * spread + VERDICT.deviation_floor) for spread in (0.1, 0.2)
    )
    assert high[:2] == pytest.approx([0.1 + near, 2.0 + far], rel=1e-4)
    assert low[:2] == pytest.approx([0.0, 2.0 - far], rel=1e-4)
