"""Sessions without a browser: pushes, resets, edits, replays and refusals."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from lagsplat.forces.grasp import NoMatterError
from lagsplat.forces.loaded_lagrangian import rollout_under_force
from lagsplat.forces.loads import ConstantLoad, PointLoad
from lagsplat.forces.operating_point import NoScaleError
from lagsplat.stage2.likelihood.parameter_vector import ParameterVector
from lagsplat.viewer.simulation.grasp import FOLLOW, GraspModel
from lagsplat.viewer.simulation.session import BEYOND, DIVERGED, UNDETERMINED
from tests.unit.forces.rocking import CONTACT, WIDTH, hold_under_polynomials, rocking
from tests.unit.forces.solid import FRONT
from tests.unit.viewer.sessions import plate, session, strip, swing, uncertain

TOP = (16.0, 6.0)
RIGHT = np.array([4.0, 0.0])


def run(one, steps: int):
    for _ in range(steps):
        one.step()
    return one.snapshot()


def test_a_push_moves_the_grasped_matter_with_it_and_it_returns():
    one = session()
    rest = one.q.copy()
    one.grasp(TOP)
    one.pull(RIGHT)
    pushed = run(one, 20)
    assert pushed.active_grasp.place(pushed.q)[0] > TOP[0] + 0.1
    one.release()
    one.edit(damping=5.0)
    settled = run(one, 900)
    assert settled.active_grasp is None
    np.testing.assert_allclose(settled.q, rest, atol=1e-3)


def test_a_driven_run_begins_as_recorded_and_another_where_it_is_farthest_from_rest():
    one = session()
    one.begin_in_motion()
    assert one.following
    assert one.frame == 0
    one.recorded, one.u = replace(one.recorded, u=one.recorded.u[:, :0]), np.zeros(0)
    one.begin_in_motion()
    assert not one.following
    away = np.abs(one.recorded.q - one.operating_point.rest.numpy())[:, 0]
    assert away[one.frame] == away.max()
    assert all(size > 0.0 for size in session().measure_ranges())


@pytest.mark.parametrize(
    ("make", "levers", "least"),
    [
        (session, [(16.0, 6.0), (16.0, 12.5)], FOLLOW),
        (swing, [(16.0, 6.0), (16.0, 12.5)], FOLLOW),
        (plate, [(0.0, -5.5, FRONT), (0.0, 0.5, FRONT)], FOLLOW),
        (strip, [(16.0, 22.0), (16.0, 17.0)], FOLLOW / 2**0.5),  # it can go two ways
    ],
    ids=["disc", "swing", "plate", "strip"],
)
def test_matter_follows_a_short_drag_at_the_tip_and_at_half_the_lever(make, levers, least):
    for at in levers:
        one = make()
        grasp, drag = one.grasp(at), np.eye(len(at))[0] * 0.2
        one.pull(drag)
        push = PointLoad(grasp.grasp_point.points, torch.from_numpy(one.active_grasp.force)[None])
        settled = one.operating_point.equilibria(push)[0].numpy()
        share = (grasp.place(settled) - at) @ drag / (drag @ drag)
        assert 0.99 * least < share < 1.01 * FOLLOW


def test_the_force_at_a_pivot_is_bounded():
    one = swing()
    gains = [one.grasp((16.0, y)).gain for y in (12.5, 15.0, 17.5, 18.5)]
    largest = FOLLOW / one.grasp_model.least_mobility
    assert gains[0] < 0.6 * largest
    np.testing.assert_allclose(gains[1:], largest)
    one.pull(np.array([WIDTH, 0.0]))
    np.testing.assert_allclose(one.active_grasp.force, [largest * WIDTH, 0.0])
    assert one.snapshot().banner == "" == run(one, 60).banner


@pytest.mark.parametrize("make", [session, swing, plate], ids=["disc", "swing", "plate"])
def test_a_drag_as_long_as_the_image_goes_beyond_the_recording_and_does_not_diverge(make):
    one = make()
    one.grasp((0.0, -3.0, FRONT) if make is plate else TOP)
    assert one.snapshot().banner == ""
    one.pull(np.eye(one.operating_point.matter.space)[0] * WIDTH)
    banners = {run(one, 1).banner for _ in range(120)}
    assert BEYOND in banners <= {"", BEYOND}
    one.pull(np.eye(one.operating_point.matter.space)[0] * 1e6)
    assert DIVERGED not in {run(one, 1).banner for _ in range(120)}


def test_the_strength_also_multiplies_the_largest_force():
    one = session()
    one.grasp(TOP)
    one.pull(100.0 * RIGHT)
    largest = one.active_grasp.force
    one.strength = 3.0
    one.pull(200.0 * RIGHT)
    np.testing.assert_allclose(one.active_grasp.force, 3.0 * largest)


def test_the_matter_of_a_grasp_goes_on_an_arc_and_its_load_changes_with_the_state():
    one = swing()
    one.grasp(TOP)
    one.pull(np.array([12.0, 6.0]))
    arm, force = np.subtract(TOP, CONTACT), one.active_grasp.force
    for angle in (0.0, 0.7, 2.5):
        q = np.array([angle])
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        np.testing.assert_allclose(one.active_grasp.place(q), CONTACT + turn @ arm, atol=1e-3)
        np.testing.assert_allclose(one.active_grasp.load(q), [force @ turn @ (-arm[1], arm[0])], rtol=1e-4)
    run(one, 60)
    loads = one.history.read().load[:, 0]
    assert np.ptp(loads) > 0.1 * loads.max()
    np.testing.assert_array_equal(loads[0], one.active_grasp.load(one.operating_point.rest.numpy())[0])
    assert abs(one.energy.error) < 0.02 * one.energy.hand_work


def test_in_space_a_push_moves_the_matter_with_it_and_one_across_the_motion_does_not():
    for force, moves in ((np.array([4.0, 0.0, 0.0]), True), (np.array([0.0, 0.0, 40.0]), False)):
        one = plate()
        one.grasp((0.0, -3.0, FRONT))
        one.pull(force)
        displacement = run(one, 20).active_grasp.place(one.q) - (0.0, -3.0, FRONT)
        assert (displacement[0] > 0.05) == moves
        np.testing.assert_allclose(displacement[2], 0.0, atol=1e-9)


def test_the_finest_brush_grasps_matter_between_its_points():
    one = session(rocking(), "forces.brush=1e-4")
    assert not one.grasp((16.0, 12.0)).is_background
    np.testing.assert_allclose(one.active_grasp.place(one.q), (16.0, 12.0))


def test_a_grasp_of_the_wall_is_marked_as_background_and_moves_nothing():
    one = session()
    grasp = one.grasp((2.0, 3.0))
    one.pull(RIGHT)
    assert grasp.is_background
    np.testing.assert_allclose(run(one, 60).q, one.operating_point.rest.numpy(), atol=1e-6)


def test_the_motion_is_that_of_the_rollout():
    one = strip()
    one.grasp((16.0, 20.0))
    one.pull(RIGHT)
    load = ConstantLoad(torch.from_numpy(one.active_grasp.load(one.q))[None])
    start = torch.from_numpy(np.stack([one.q, one.v]))
    u = torch.from_numpy(one.u).expand(1, 31, -1)
    expected, _ = rollout_under_force(
        one.operating_point.law, start[:1], start[1:], u, 30 * [load], dt_s=one.dt_s
    )
    np.testing.assert_allclose(run(one, 30).q, expected[0, 30].numpy(), rtol=1e-6, atol=1e-8)


def test_resets_go_to_rest_and_to_recorded_frames():
    one = session()
    run(one, 5)
    one.to_frame(7)
    np.testing.assert_array_equal(one.q, one.recorded.q[7])
    assert one.snapshot().frame == 7
    assert run(one, 1).frame == 8
    one.to_rest()
    np.testing.assert_allclose(one.q, one.operating_point.rest.numpy(), atol=1e-9)
    with pytest.raises(ValueError, match="frames 0 to 59"):
        one.to_frame(60)


def test_recorded_inputs_are_replayed_and_restart_after_the_clip():
    one = session()
    one.recorded.u[:, 0] = np.linspace(0.0, 1.0, 60)
    one.to_frame(58)
    one.follow(True)
    assert run(one, 1).u[0] == one.recorded.u[58, 0]
    assert run(one, 2).u[0] == one.recorded.u[0, 0]
    one.set_inputs(np.array([0.25]))
    assert run(one, 3).u[0] == 0.25


def test_a_motion_that_diverges_stops_says_so_and_can_be_reset():
    one = session()
    one.v = np.full(1, 1e9)
    snapshot = run(one, 3)
    assert snapshot.status == "stopped"
    assert "diverged" in snapshot.banner
    assert np.isfinite(snapshot.q).all()
    one.to_rest()
    assert run(one, 3).status == "running"


def test_a_history_can_be_replayed():
    one = strip()
    one.grasp((16.0, 20.0))
    one.pull(RIGHT)
    run(one, 20)
    one.edit(damping=2.0)
    one.to_frame(3)
    run(one, 20)
    history = one.history.read()
    assert history.segments == ((0, 20), (20, 40))
    again = strip()
    again.replay(history)
    run(again, 40)
    assert again.replaying is None
    np.testing.assert_allclose(again.history.read().q, history.q, atol=1e-12)
    with pytest.raises(ValueError, match="open the run"):
        session().replay(history)


def test_one_measured_push_gives_the_energy_scale():
    one = session()
    with pytest.raises(ValueError, match="push the object once"):
        one.calibrate(force=1.0, moved_px=1.0)
    one.grasp(TOP)
    one.pull(RIGHT)
    kappa = one.calibrate(force=2.0, moved_px=1.0)
    points, rest = one.active_grasp.grasp_point.points, one.operating_point.rest
    push = PointLoad(points, torch.tensor([[2.0 * kappa, 0.0]], dtype=torch.float64))
    answer = points.carry(one.operating_point.equilibria(push)) - points.carry(rest[None])
    assert float(answer[0, 0, 0]) == pytest.approx(1.0, rel=0.05)
    one.grasp((2.0, 3.0))
    one.pull(RIGHT)
    with pytest.raises(NoScaleError, match="not at all"):
        one.calibrate(force=2.0, moved_px=1.0)


@pytest.mark.parametrize(
    "act",
    [
        lambda one: one.grasp((99.0, 3.0)),
        lambda one: one.grasp((float("nan"), 3.0)),
        lambda one: one.edit(inertia=0.0),
        lambda one: one.edit(stiffness=float("inf")),
        lambda one: one.set_inputs(np.array([np.nan])),
        lambda one: one.set_inputs(np.zeros(2)),
        lambda one: (one.grasp(TOP), one.pull(np.array([np.inf, 0.0]))),
    ],
    ids=["outside", "nan", "massless", "rigid", "nan input", "two inputs", "endless"],
)
def test_invalid_commands_are_refused_and_change_nothing(act):
    one = session()
    before = one.snapshot()
    with pytest.raises((ValueError, NoMatterError)):
        act(one)
    assert one.edits == before.edits
    assert (one.u == before.u).all()
    assert one.active_grasp is None or not one.active_grasp.force.any()


def test_a_push_tells_how_far_its_answer_differs_among_laws():
    one = uncertain(0.1)
    one.grasp((16.0, 20.0))
    one.pull(np.array([0.0, 4.0]))
    way = one.active_grasp.mobility @ one.active_grasp.force
    assert np.sqrt(one.active_grasp.covariance[1, 1]) == pytest.approx(0.1 * abs(way[1]), rel=0.5)
    assert not one.active_grasp.is_undetermined
    assert replace(one.snapshot(), coverage_distance=0.5).banner == ""


def test_a_push_that_the_recording_does_not_determine_is_told():
    one = uncertain(3.0)
    one.grasp((16.0, 20.0))
    assert not one.active_grasp.is_undetermined
    one.pull(np.array([0.0, 8.0]))
    assert one.active_grasp.is_undetermined
    assert replace(one.snapshot(), coverage_distance=0.5).banner == UNDETERMINED


def test_of_one_coordinate_the_answer_is_known_up_to_its_unit():
    point = hold_under_polynomials(rocking())
    theta = ParameterVector(point.law).read().numpy()
    draws = theta * (1.0 + 0.1 * np.random.default_rng(0).standard_normal((20, len(theta))))
    model = GraspModel(point, session().forces, draws)
    assert len(model.spread) == 20
    assert np.abs(model.spread).max() < 1e-6 * np.abs(model.compliance).max()
