"""Sessions without a browser: pushes, resets, edits, replays and refusals."""

import numpy as np
import pytest
import torch

from lagsplat.forces.grasp import NoMatterError
from lagsplat.forces.loaded_lagrangian import rollout_under_force
from lagsplat.forces.loads import ConstantLoad, PointLoad
from lagsplat.forces.operating_point import NoScaleError
from lagsplat.viewer.simulation.grasp import FOLLOW
from tests.unit.forces.rocking import CONTACT, rocking
from tests.unit.forces.solid import FRONT
from tests.unit.viewer.sessions import plate, session, strip, swing

TOP = (16.0, 6.0)
RIGHT = np.array([1.0, 0.0])


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


@pytest.mark.parametrize("make", [session, plate], ids=["disc", "plate"])
def test_the_matter_that_moves_most_follows_a_small_drag_by_a_fixed_share_of_its_way(make):
    one = make()
    point, gain = one.operating_point, one.grasp_model.gain
    ways = point.matter.jacobian(point.rest)[:, :, 0]
    size = ways.norm(dim=1)
    far = torch.nonzero(size >= 0.5 * size.max())[:, 0]
    drags = 1e-4 * ways[far] / size[far, None]
    points = point.matter.every[far]
    answer = points.carry_each(point.equilibria(PointLoad(points, gain * drags))) - points.at
    shares = answer.norm(dim=1) / drags.norm(dim=1)
    assert float(shares.median()) == pytest.approx(FOLLOW, rel=1e-3)
    assert 0.2 < float(shares.min()) < float(shares.max()) < 1.3


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
    for force, moves in ((np.array([1.0, 0.0, 0.0]), True), (np.array([0.0, 0.0, 40.0]), False)):
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


def test_beyond_the_recording_there_is_a_banner():
    one = session()
    assert one.snapshot().banner == ""
    one.grasp(TOP)
    one.pull(2.0 * RIGHT)
    assert any("Beyond the recording" in run(one, 1).banner for _ in range(60))


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
