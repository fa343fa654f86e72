"""Several recordings: whether the cause holds in each, and which of them disagree."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from lagsplat.diagnose.core.result import FileAgreement
from lagsplat.diagnose.effects.base import Direction, PlacedEffect
from lagsplat.diagnose.effects.elasticity import linear_stiffness
from lagsplat.diagnose.effects.external import constant_force
from lagsplat.diagnose.inference.consistency import check_files, locate_files
from lagsplat.diagnose.inference.placement import measure_motion_scales
from lagsplat.diagnose.inference.problem import EstimationProblem, HypothesisFit
from tests.unit.diagnose.toys import Law, contest, film, own, wave

NOISE = 0.01


def stiffer(ratio: float) -> Law:
    """The whole potential steeper."""
    return lambda t, q, v, u, z: (own(q, v, u) + (ratio - 1.0) * own(q, 0.0, 0.0), [])


def leaning(t: float, q: float, v: float, u: float, z: np.ndarray) -> tuple[float, list[float]]:
    """A constant force and no other stiffness."""
    return own(q, v, u) + 3.0, []


def make(laws: Sequence[Law]) -> EstimationProblem:
    films = [film(law, u=wave(i), noise=NOISE, seconds=8.0, seed=i) for i, law in enumerate(laws)]
    return replace(contest(films), period_s=1.0)


def fit(problem: EstimationProblem, effect=None, start: float = 0.0) -> HypothesisFit:
    n = problem.rollout_model.nuisance.size
    if effect is None:
        return HypothesisFit((), problem.fit((), np.zeros(n)))
    along = Direction("q0", np.ones(1), 1.0)
    placed = PlacedEffect(effect, measure_motion_scales(problem.rollout_model, along), direction=along)
    return HypothesisFit((placed,), problem.fit((placed,), np.concatenate([[start], np.zeros(n)])))


def check(laws: Sequence[Law]) -> tuple[FileAgreement, ...]:
    problem = make(laws)
    chosen = fit(problem, linear_stiffness.EFFECT, 0.2)
    rivals = [fit(problem), fit(problem, constant_force.EFFECT, 0.1)]
    given = problem.rollout_model.model
    noise = 2.0 * max(min(each.fit.misfit for each in (chosen, *rivals)) / problem.degrees_of_freedom, 1.0)
    return check_files(problem, chosen, rivals, given=given, noise_inflation=noise, materiality=0.05)


def test_one_cause_in_all_files_forecasts_each_from_the_others() -> None:
    found = check([stiffer(1.3)] * 3)
    assert [each.file for each in found] == ["film 0", "film 1", "film 2"]
    for each in found:
        assert each.disagrees == ""
        assert each.name == "linear_stiffness"
        assert each.own_lead < 0.0  # shared parameters are the simpler explanation
        assert each.before > 5.0 * each.floor
        assert each.after == pytest.approx(each.floor, rel=0.5)
        assert each.blocks > 3


def test_a_file_of_another_state_is_named_with_its_parameters() -> None:
    found = check([stiffer(1.3), stiffer(1.3), stiffer(1.6), stiffer(1.3)])
    odd = found[2]
    assert odd.disagrees.startswith("another state of the mechanism: ratio 1.6 instead of")
    assert odd.own_lead == max(each.own_lead for each in found)
    assert odd.after > 3.0 * odd.floor


def test_a_file_of_another_cause_is_named_with_it() -> None:
    odd = check([stiffer(1.3), stiffer(1.3), leaning, stiffer(1.3)])[2]
    assert odd.name == "constant_force"
    assert odd.disagrees.startswith("another cause: constant force explains it better by")


def test_a_file_without_the_effect_is_named() -> None:
    odd = check([stiffer(1.3), stiffer(1.3), stiffer(1.0)])[2]
    assert odd.disagrees.startswith("another state of the mechanism: ratio 1 instead of")


def test_one_file_has_nothing_to_agree_with() -> None:
    assert check([stiffer(1.3)]) == ()


def test_windows_know_their_file() -> None:
    problem = make([stiffer(1.0)] * 2)
    home = locate_files(problem.windows, problem.dataset)
    assert home.tolist() == sorted(home.tolist())
    assert set(home.tolist()) == {0, 1}
    border = problem.dataset.clips[1, 0]
    assert ((problem.windows.first >= border) == (home == 1)).all()
