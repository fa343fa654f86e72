"""What a recording can show is what an effect of the expected size would gain."""

from dataclasses import asdict

import numpy as np
import pytest

from lagsplat.diagnose.effects.base import DisturbanceHints
from lagsplat.diagnose.effects.registry import catalogue, list_effects
from lagsplat.diagnose.inference.excitation import grade_excitation
from lagsplat.diagnose.inference.model_selection import continue_fit, try_candidate
from lagsplat.diagnose.inference.placement import place_effects
from lagsplat.diagnose.inference.problem import EstimationProblem, HypothesisFit
from lagsplat.diagnose.inference.score_test import ScoreTestResult, score_test
from lagsplat.io.trajectory.trajectory import Trajectory
from tests.unit.diagnose.toys import contest, film, own, wave


def run_score_test(problem: EstimationProblem, *names: str) -> tuple[HypothesisFit, list[ScoreTestResult]]:
    hints = [DisturbanceHints((), ())]
    every = place_effects(problem.rollout_model, hints, q_names=("q0",), u_names=("u0",), without=())
    offers = [offer for offer in every if offer.effect.name in names]
    none = HypothesisFit((), problem.fit((), np.zeros(problem.rollout_model.nuisance.size)))
    return none, score_test(problem, (), none.fit, offers)


def record(damping: float = 0.0, **options: float) -> Trajectory:
    def move(t: float, q: float, v: float, u: float, z: np.ndarray) -> tuple[float, list[float]]:
        return own(q, v, u) - damping * v, []

    return film(move, u=wave(), **{"noise": 0.02, "seconds": 16.0, **options})


def inform(motion: Trajectory) -> float:
    (drag,) = run_score_test(contest([motion]), "quadratic_drag")[1]
    return drag.information


def test_an_effect_gains_what_was_foretold() -> None:
    """At a tenth of the expected size, where the motion is linear in it; the damping has a tolerance."""
    (expected,) = run_score_test(contest([record()]), "viscous_damping")[1]
    foretold = 0.01 * expected.information
    size = 0.1 * expected.placed.effect.parameters[0].prior.deviation
    damped = contest([record(float(expected.placed.to_physical(np.array([[size]]))[0, 0]))])
    none, (test,) = run_score_test(damped, "viscous_damping")
    right = continue_fit(damped, try_candidate(damped, (), [test], starts=1))
    assert 0.5 * (none.fit.cost - right.fit.cost) == pytest.approx(foretold, rel=0.4)
    assert foretold > 10.0


def test_noise_and_short_recordings_show_less() -> None:
    usual = inform(record())
    # noise and length do not matter as far as a tolerance imitates it
    assert 1.5 < usual / inform(record(noise=0.04)) < 4.5
    assert 1.0 < inform(record(seconds=32.0)) / usual < 3.0


def test_grades_go_by_the_evidence_and_single_samples_are_not_graded() -> None:
    known = {"coulomb_friction": 40.0, "creep": 1.5, "input_lag": 0.2}
    rows = {row.effect: row for row in grade_excitation(known, list_effects())}
    assert [rows[name].excited for name in known] == ["yes", "weak", "no"]
    assert rows["coulomb_friction"].record == ""
    assert rows["creep"].record == catalogue()["creep"].needs
    assert rows["creep"].smallest == pytest.approx(2.0**0.5)
    assert (rows["input_gain"].excited, rows["input_gain"].smallest) == ("no", None)
    assert not {"time_jitter", "frame_drops"} & set(rows)
    assert asdict(rows["creep"]).keys() == {"effect", "excited", "smallest", "record"}
