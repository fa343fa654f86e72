"""Which two hypotheses an experiment is planned for, and what is said of it."""

from dataclasses import replace

import numpy as np
import pytest

from lagsplat.diagnose.core.config import EXPERIMENT
from lagsplat.diagnose.core.result import Candidate
from lagsplat.diagnose.effects.base import Direction, PlacedEffect
from lagsplat.diagnose.effects.friction import quadratic_drag, viscous_damping
from lagsplat.diagnose.effects.measurement import time_jitter
from lagsplat.diagnose.experiment.planning import plan_experiments, select_leaders
from lagsplat.diagnose.inference.model_selection import ModelRanking
from lagsplat.diagnose.inference.placement import measure_motion_scales
from lagsplat.diagnose.inference.problem import EstimationProblem, HypothesisFit
from tests.unit.diagnose.toys import contest, film, own

DRAG = 0.5


def dragged(t: float, q: float, v: float, u: float, z: np.ndarray) -> tuple[float, list[float]]:
    return own(q, v, u) - DRAG * abs(v) * v, []


def fit(problem: EstimationProblem, effect, start: float) -> HypothesisFit:
    along = Direction("q0", np.ones(1), 1.0)
    placed = PlacedEffect(effect, measure_motion_scales(problem.rollout_model, along), direction=along)
    n = problem.rollout_model.nuisance.size
    return HypothesisFit((placed,), problem.fit((placed,), np.concatenate([[start], np.zeros(n)])))


@pytest.fixture(scope="module")
def swinging() -> tuple[EstimationProblem, ModelRanking]:
    """A swing of one size, from which drag and damping can hardly be told apart."""
    sine = film(dragged, u=lambda t: 0.3 * float(np.sin(5.0 * t)), start=(0.0, 0.0), seconds=10.0, noise=0.03)
    problem = contest([sine])
    none = HypothesisFit((), problem.fit((), np.zeros(problem.rollout_model.nuisance.size)))
    found = fit(problem, quadratic_drag.EFFECT, 0.1), fit(problem, viscous_damping.EFFECT, 0.1)
    return problem, ModelRanking(none, found, 2.0)


def plan(problem: EstimationProblem, *leaders: HypothesisFit):
    names = {"q_names": ("angle",), "u_names": ("torque",)}
    return plan_experiments(problem, leaders, noise_inflation=2.0, window_s=2.0, **names)


def test_the_first_suggestion_separates_most_a_second_and_says_how(swinging) -> None:
    problem, ranking = swinging
    planned = plan(problem, *ranking.found)
    assert planned.between == ("quadratic drag (q0)", "viscous damping (q0)")
    assert 1 <= len(planned.suggestions) <= 3
    rates = [each.nats / each.duration_s for each in planned.suggestions]
    assert rates == sorted(rates, reverse=True)
    assert len({each.kind for each in planned.suggestions}) == len(planned.suggestions)
    first = planned.suggestions[0]
    assert first.low <= first.nats <= first.high
    assert first.repeats == max(1, np.ceil(EXPERIMENT.decisive / first.nats))
    for word in (f"{first.nats:.3g} nats", "quadratic drag (q0)", f"{first.duration_s:.3g} s", "angle at"):
        assert word in first.text
    assert set(first.input) == {"t", "torque"}
    assert np.abs(first.input["torque"]).max() <= 0.3 + 1e-9


def test_more_noise_separates_less_and_much_noise_nothing(swinging) -> None:
    problem, ranking = swinging
    quiet = plan(problem, *ranking.found).suggestions[0].nats
    loud = plan(replace(problem, sigma=100.0 * problem.sigma), *ranking.found)
    assert quiet > EXPERIMENT.bare
    assert loud.suggestions == ()
    assert "No experiment within the recorded inputs" in loud.reason


def test_two_equal_hypotheses_are_said_to_be_inseparable(swinging) -> None:
    problem, ranking = swinging
    planned = plan(problem, ranking.found[1], replace(ranking.found[1]))
    assert planned.suggestions == ()
    assert "both move alike" in planned.reason


def test_unknown_has_no_prediction_and_a_set_is_one_hypothesis(swinging) -> None:
    _, ranking = swinging
    drag, damping = ranking.found
    said = [
        Candidate("unknown", 0.5),
        Candidate("quadratic_drag", 0.2),
        Candidate("none", 0.1),
        Candidate("viscous_damping", 0.05),
    ]
    assert select_leaders(said, ranking, ranking.none) == (drag, ranking.none)
    both = HypothesisFit((*drag.effects, *damping.effects), drag.fit)
    assert select_leaders([said[1], said[3], said[2]], ranking, both) == (both, ranking.none)
    assert select_leaders(said[:2], ranking, ranking.none) == ()


def test_no_experiment_is_planned_for_an_effect_on_single_samples(swinging) -> None:
    _, ranking = swinging
    scales = ranking.found[0].effects[0].scales
    jitter = HypothesisFit((PlacedEffect(time_jitter.EFFECT, scales),), ranking.none.fit)
    said = [Candidate("time_jitter", 0.6), Candidate("none", 0.3)]
    assert select_leaders(said, replace(ranking, found=(jitter,)), jitter) == ()
