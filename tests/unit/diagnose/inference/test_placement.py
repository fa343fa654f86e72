"""Which effects are tried where, and how they are found."""

import numpy as np
import pytest

from lagsplat.diagnose.effects.base import Direction, DisturbanceHints, ForceEffect, InputEffect
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.diagnose.inference.placement import (
    extract_hints,
    find_spectral_lines,
    measure_motion_scales,
    place_effects,
)
from lagsplat.diagnose.inference.problem import EstimationProblem
from lagsplat.diagnose.inference.profile_likelihood import format_parameter_unit
from lagsplat.diagnose.residual.latent_force import estimate_latent_force
from lagsplat.io.trajectory.trajectory import Trajectory
from tests.unit.diagnose.residuals import made
from tests.unit.diagnose.toys import OMEGA, contest, coupled, film, name_place, oscillator, own, wave


@pytest.fixture(scope="module")
def driven() -> EstimationProblem:
    return contest([film(u=wave(), seconds=8.0)])


def offered(one: EstimationProblem, *, without: tuple[str, ...] = (), hint: DisturbanceHints | None = None):
    known = [hint or DisturbanceHints(((1.0, 1.4), (3.0, 3.2)), (0.7,), (1.3,))]
    names = tuple(f"u{i}" for i in range(one.rollout_model.dataset.u.shape[1]))
    return place_effects(one.rollout_model, known, q_names=("q0",), u_names=names, without=without)


ELSEWHERE = {"armature", "circulatory_force", "base_motion", "controller_gain"}
"""Effects without a place on one coordinate of constant inertia whose input is a force."""


def test_every_effect_has_a_place_where_inputs_are_logged(driven: EstimationProblem) -> None:
    assert {one.effect.name for one in offered(driven)} == set(catalogue()) - ELSEWHERE
    labels = [name_place(one) for one in offered(driven)]
    assert len(labels) == len(set(labels))


def test_without_inputs_none_of_their_effects_is_offered() -> None:
    for quiet in (film(seconds=8.0), film(seconds=8.0, command=lambda t: 0.4)):
        found = offered(contest([quiet], model=oscillator(n_u=quiet.n_u)))
        assert found
        assert not [name_place(one) for one in found if isinstance(one.effect, InputEffect)]


def test_what_is_left_out_is_not_offered(driven: EstimationProblem) -> None:
    names = {one.effect.name for one in offered(driven, without=("creep", "time_offset"))}
    assert names == set(catalogue()) - ELSEWHERE - {"creep", "time_offset"}


def test_a_disturbance_is_looked_for_where_the_hints_say(driven: EstimationProblem) -> None:
    found = {one.effect.name: one for one in offered(driven)}
    periodic = found["external_periodic_force"]
    assert periodic.grid is not None
    assert periodic.grid[0][0] * periodic.scales.of("rate") == pytest.approx(2.0 * np.pi * 0.7)
    push = found["external_push"]
    assert push.grid is not None
    unit = push.scales.of("time")
    times, lasts = np.array(push.grid[0][:3]) * unit, np.array(push.grid[0][3:]) * unit
    assert times[:2] == pytest.approx([1.2, 3.1])
    assert lasts[:2] == pytest.approx([0.4, 0.2])
    assert times[2] < 0.0  # a push that is not there stands where no window is
    none = {one.effect.name for one in offered(driven, hint=DisturbanceHints((), ()))}
    lines = {"external_push", "external_periodic_force", "parametric_stiffness"}
    assert none == set(catalogue()) - ELSEWHERE - lines


def test_a_stop_is_not_looked_for_on_a_side_that_is_not_reached() -> None:
    def shifted(t: float, q: float, v: float, u: float, z: np.ndarray) -> tuple[float, list[float]]:
        return own(q, v, u) + 60.0, []

    one_sided = contest([film(shifted, seconds=8.0, start=(1.6, 0.0))], model=oscillator(n_u=0))
    stops = [one.variant for one in offered(one_sided) if one.effect.name == "end_stop"]
    assert stops == ["upper"]


def test_what_acts_in_a_joint_is_looked_for_between_two_coordinates_as_well() -> None:
    rng, time = np.random.default_rng(0), np.arange(400) / 50.0
    q = 0.4 * np.sin(np.array([5.0, 7.0]) * time[:, None])
    one = contest([Trajectory(time, q, rng.normal(size=(400, 2)), source="made")], model=coupled())
    found = place_effects(
        one.rollout_model,
        [DisturbanceHints((), ())] * 2,
        q_names=("a", "b"),
        u_names=("u0", "u1"),
        without=(),
    )
    between = {name_place(one) for one in found if one.location == "b - a"}
    assert between == {
        "viscous_damping b - a",
        "coulomb_friction b - a",
        "stribeck_friction b - a",
        "creep b - a",
        "linear_stiffness b - a spring",
        "circulatory_force b - a",
        "circulatory_force b - a gyroscopic",
    }
    place = next(one.direction for one in found if one.location == "b - a")
    np.testing.assert_array_equal(place.covector, [-1.0, 1.0])
    inertia = one.rollout_model.model.inertia
    assert place.inertia == pytest.approx((inertia[0, 0] + inertia[1, 1] - 2.0 * inertia[0, 1]) / 4.0)
    assert len({name_place(one) for one in found}) == len(found)
    friction = next(one for one in found if name_place(one) == "coulomb_friction b - a")
    assert format_parameter_unit(friction, "acceleration") == "(b - a)/s^2"


def test_sizes_are_those_of_the_motion(driven: EstimationProblem) -> None:
    record, model = driven.rollout_model.dataset, driven.rollout_model.model
    place = Direction.of("q0", np.ones(1), driven.rollout_model.model)
    size = measure_motion_scales(driven.rollout_model, place)
    assert size.coordinate == pytest.approx(np.sqrt(np.mean(record.q**2)), rel=5e-3)
    assert size.velocity == pytest.approx(np.sqrt(np.mean(record.v**2)), rel=1e-6)
    assert size.stiffness == pytest.approx(OMEGA**2, rel=1e-6)
    assert size.frame_s == pytest.approx(0.02)
    assert place.inertia == model.inertia[0, 0]
    assert measure_motion_scales(driven.rollout_model, place, "upper").reach == pytest.approx(
        record.q.max(), rel=1e-2
    )
    assert measure_motion_scales(driven.rollout_model, place, "lower").reach == pytest.approx(
        -record.q.min(), rel=1e-2
    )


def test_every_law_that_remembers_says_from_what() -> None:
    for effect in catalogue().values():
        if isinstance(effect, ForceEffect):
            assert set(effect.memory_start) <= {"zero", "s", "v"}


def test_the_line_of_a_residual_is_the_first_hint() -> None:
    one = made(lambda t, q, v, u: 3.0 * np.sin(2.0 * np.pi * 1.62 * t))
    assert find_spectral_lines(one, one.residual[:, 0])[0] == pytest.approx(1.62, abs=0.02)


def test_a_push_is_a_hint() -> None:
    def pushed(t: float, q: float, v: float, u: float, z: np.ndarray) -> tuple[float, list[float]]:
        return own(q, v, u) + 25.0 * (4.0 < t < 4.3), []

    motion = film(pushed, u=wave(), seconds=8.0, noise=0.003)
    found = extract_hints(
        estimate_latent_force(oscillator(), [motion], period_s=1.0, hold="linear"), period_s=1.0
    )
    assert len(found) == 1
    start, end = found[0].pushes[0]
    assert start < 4.2 < end
    assert end - start < 1.2


def test_a_push_in_the_first_file_leaves_the_second_alone() -> None:
    both = contest([film(u=wave(), seconds=8.0), film(u=wave(1), seconds=8.0, seed=1)])
    push = next(one for one in offered(both) if one.effect.name == "external_push")
    assert push.grid is not None
    x = [1.0, 0.0, 0.0] + [
        p.prior.unknown(g) for p, g in zip(push.effect.parameters[3:], push.grid[0], strict=True)
    ]
    n = both.rollout_model.nuisance.size
    there = both.predict((push,))(np.array([[*x, *[0.0] * n]]), both.initial_states[None])[0]
    still = both.predict(())(np.zeros((1, n)), both.initial_states[None])[0]
    moved = np.abs(there - still).max(axis=(1, 2)) > 1e-6
    second = both.windows.first >= both.rollout_model.dataset.clips[1, 0]
    assert moved[~second].any()
    assert not moved[second].any()
