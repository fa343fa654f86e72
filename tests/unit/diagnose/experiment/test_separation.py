"""The expected log Bayes factor of an experiment, against motions that scipy computes."""

from dataclasses import replace

import numpy as np
import pytest

from lagsplat.diagnose.effects.base import Direction, PlacedEffect
from lagsplat.diagnose.effects.elasticity import creep, linear_stiffness
from lagsplat.diagnose.effects.inertia import mass_change
from lagsplat.diagnose.experiment.candidates import Experiment
from lagsplat.diagnose.experiment.separation import FittedHypothesis, compute_separation, simulate_experiment
from lagsplat.diagnose.inference.placement import measure_motion_scales
from lagsplat.diagnose.inference.problem import EstimationProblem, HypothesisFit
from tests.unit.diagnose.toys import contest, film, oscillator, own, wave

STIFFER, NOISE, DT_S = 1.02, 0.01, 0.02
TIME_S = np.arange(251) * DT_S


@pytest.fixture(scope="module")
def problem() -> EstimationProblem:
    return contest([film(u=wave(), seconds=12.0, noise=NOISE)], model=oscillator(hard=0.0))


def hypothesis(problem: EstimationProblem, *ratios: float, effect=linear_stiffness.EFFECT, spread=1e-9):
    """The effect with this ratio, known to within ``spread``, and a sim that is exactly known."""
    along = Direction("q0", np.ones(1), 1.0)
    placed = PlacedEffect(effect, measure_motion_scales(problem.rollout_model, along), direction=along)
    n = problem.rollout_model.nuisance.size
    x = np.concatenate([np.log(ratios), np.zeros(n)])
    deviation = np.concatenate([[spread] * len(ratios), np.full(n, 1e-9)])
    effects = (placed,) * len(ratios)
    names = tuple(each.effect.name for each in effects)
    return FittedHypothesis(names, effects, x, np.diag(deviation**2))


def release(*, payload: float = 0.0) -> Experiment:
    return Experiment("release", "a release", TIME_S, np.zeros((len(TIME_S), 1)), np.array([0.8]), payload)


def separate(problem, truth, rival, experiment, *, inflation=1.0) -> float:
    found = compute_separation(
        problem, truth, rival, experiment, noise_inflation=inflation, window_s=TIME_S[-1]
    )
    return found.nats


def test_a_rival_that_cannot_refit_loses_half_the_square_of_the_difference(problem) -> None:
    truth, rival = hypothesis(problem, STIFFER), hypothesis(problem)

    def law(ratio: float):
        return lambda t, q, v, u, z: (own(q * 1.0, v, u, hard=0.0) + (1.0 - ratio) * (2 * np.pi) ** 2 * q, [])

    moved, plain = (film(law(ratio), seconds=TIME_S[-1] + DT_S).q for ratio in (STIFFER, 1.0))
    away = (moved - plain)[:, 0]
    # the state at the start is fitted: what a change of it explains does not count
    free = [
        film(law(1.0), start=start, seconds=TIME_S[-1] + DT_S).q[:, 0] for start in ((0.81, 0), (0.8, 0.1))
    ]
    slopes = np.stack([each - plain[:, 0] for each in free], axis=1)
    rest = away - slopes @ np.linalg.lstsq(slopes, away, rcond=None)[0]
    wanted = 0.5 * np.sum((rest / problem.sigma[0]) ** 2)
    assert wanted > 10.0
    assert separate(problem, truth, rival, release()) == pytest.approx(wanted, rel=0.02)
    assert separate(problem, truth, rival, release(), inflation=4.0) == pytest.approx(wanted / 4.0, rel=0.02)


def test_a_rival_that_can_refit_imitates(problem) -> None:
    truth = hypothesis(problem, STIFFER)
    assert separate(problem, truth, hypothesis(problem, 1.0), release()) > 10.0
    assert separate(problem, truth, hypothesis(problem, 1.0, spread=0.3), release()) < 0.05


def test_a_known_payload_tells_mass_from_stiffness_where_a_release_does_not(problem) -> None:
    undamped = replace(problem.rollout_model.model, damping=np.zeros((1, 1, 1)))
    free = replace(problem, rollout_model=replace(problem.rollout_model, model=undamped))
    stiff = hypothesis(free, 1.1)
    spread = 0.003  # as the frequency in earlier recordings leaves it
    heavy = hypothesis(free, 1.0 / 1.1, effect=mass_change.EFFECT, spread=spread)
    assert separate(free, stiff, heavy, release()) < 0.05
    # the swing asks for a mass of 1.5 / 1.1 less the payload, which it may take at the cost of its distance
    moved = np.log(1.1 * (1.5 / 1.1 - 0.5))
    assert separate(free, stiff, heavy, release(payload=0.5)) == pytest.approx(
        0.5 * (moved / spread) ** 2, rel=0.1
    )


def test_the_payload_slows_the_swing(problem) -> None:
    def swings(payload: float) -> int:
        states = simulate_experiment(problem, hypothesis(problem), release(payload=payload))[1]
        return int(np.count_nonzero(np.diff(np.sign(states[:, 0]))))

    assert swings(3.0) == pytest.approx(swings(0.0) / 2.0, abs=1)


def test_a_memory_that_began_in_the_old_recording_is_no_parameter_of_a_new_one(problem) -> None:
    along = Direction("q0", np.ones(1), 1.0)
    scales = measure_motion_scales(problem.rollout_model, along)
    placed = PlacedEffect(creep.EFFECT.with_free_memory((0,)), scales, direction=along)
    n = problem.rollout_model.nuisance.size
    fit = problem.fit((placed,), np.concatenate([[0.1, 0.0, 0.3], np.zeros(n)]))
    kept = FittedHypothesis.of(problem, HypothesisFit((placed,), fit), noise_inflation=1.0)
    law = len(creep.EFFECT.parameters)
    assert placed.size == law + 1
    assert kept.x.tolist() == [*fit.x[:law], *fit.x[law + 1 :]]
    assert kept.covariance.shape == (law + n, law + n)


def test_a_motion_that_diverges_separates_nothing(problem) -> None:
    model = replace(problem.rollout_model.model, potential=np.array([0.0, 0.0, -1e4, 0.0, 0.0]))
    wild = replace(problem, rollout_model=replace(problem.rollout_model, model=model))
    assert separate(wild, hypothesis(wild, STIFFER), hypothesis(wild), release()) == 0.0
