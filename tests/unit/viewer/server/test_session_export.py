"""Saved sessions: read back bit for bit, replayed, and used in a diagnosis."""

import cv2
import numpy as np
import pytest

from lagsplat.io.robot_log.write import read_session
from lagsplat.io.sources import find_sources, read_sources
from lagsplat.viewer.rendering.renderer import open_renderer
from lagsplat.viewer.server.session_export import draw_drag_arrow, export_session, load_history
from tests.unit.viewer.sessions import plate, session, strip

RIGHT = np.array([5.0, 1.0])


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    one = strip()
    one.grasp((16.0, 20.0))
    one.pull(RIGHT)
    for _ in range(40):
        one.step()
    one.release()
    for _ in range(30):
        one.step()
    one.to_frame(5)
    for _ in range(20):
        one.step()
    renderer, small_renderer = (open_renderer(one.operating_point, side=side) for side in (64, 32))
    stem = tmp_path_factory.mktemp("session") / "session_001"
    meta, gain = {"inputs": ["push"], "title": "strip"}, one.grasp_model.usual_gain
    paths = export_session(stem, one.history.read(), renderer, meta, gain=gain, small_renderer=small_renderer)
    return one, paths


def test_a_saved_session_is_read_back_bit_for_bit_and_replays_the_same(saved):
    one, (mcap, _, _) = saved
    history, kept = load_history(mcap), one.history.read()
    for name in ("q", "v", "u", "load", "force", "place", "edits", "energy", "clip"):
        np.testing.assert_array_equal(getattr(history, name), getattr(kept, name), err_msg=name)
    again = strip()
    again.replay(history)
    for _ in range(len(history)):
        again.step()
    np.testing.assert_array_equal(again.history.read().q, kept.q)


def test_a_session_is_a_trajectory_for_a_diagnosis_with_its_loads_as_inputs(saved):
    one, (mcap, _, _) = saved
    sources = find_sources(str(mcap))
    assert [source.kind for source in sources] == ["trajectory"]
    (motion,) = read_sources(sources)
    assert motion.u_names == ("push", "push0", "push1")
    assert motion.segments == ((0, 70), (70, 90))
    np.testing.assert_array_equal(motion.q, one.history.read().q)
    np.testing.assert_array_equal(motion.u[:, 1:], one.history.read().load)


def test_the_video_shows_the_motion_and_the_arrow(saved):
    _, (_, film, animation) = saved
    reader = cv2.VideoCapture(str(film))
    frames = []
    while (found := reader.read())[0]:
        frames.append(found[1].astype(float))
    assert len(frames) == pytest.approx(90 / 60 * 30, abs=2)
    assert np.abs(frames[15] - frames[0]).max() > 60
    assert animation.stat().st_size > 1000


def test_an_arrow_points_along_the_drag(saved):
    one, _ = saved
    renderer = open_renderer(one.operating_point, side=64)
    plain = renderer.draw(one.q)
    drawn = draw_drag_arrow(plain, renderer, np.array([10.0, 12.0]), np.array([8.0, 0.0]))
    _, columns = np.nonzero(np.abs(drawn.astype(int) - plain).sum(2) > 60)
    assert 17 <= columns.min() < columns.max() <= 42


def test_a_session_in_space_keeps_its_forces_and_is_refused_by_a_planar_run(tmp_path):
    one = plate()
    one.grasp((0.0, -3.0, 90.0))
    one.pull(np.array([4.0, 0.0, 2.0]))
    for _ in range(30):
        one.step()
    renderer = open_renderer(one.operating_point, side=64)
    stem, gain = tmp_path / "s", one.grasp_model.usual_gain
    export_session(stem, one.history.read(), renderer, {}, gain=gain, small_renderer=renderer)
    history = load_history(tmp_path / "s.mcap")
    assert history.force.shape == history.place.shape == (30, 3)
    np.testing.assert_array_equal(history.force[-1], one.active_grasp.force)
    again = plate()
    again.replay(history)
    for _ in range(30):
        again.step()
    np.testing.assert_array_equal(again.history.read().q, history.q)
    with pytest.raises(ValueError, match="forces in 3 dimensions"):
        session().replay(history)
    drawn = draw_drag_arrow(
        renderer.draw(one.q), renderer, np.array([0.0, -3.0, 90.0]), np.array([8.0, 0.0, 0.0])
    )
    _, columns = np.nonzero(np.abs(drawn.astype(int) - renderer.draw(one.q)).sum(2) > 60)
    assert 28 <= columns.min() < columns.max() <= 54  # 8 px a tenth nearer than the pivot, twice as large


def test_files_that_are_no_session_are_refused(saved, tmp_path):
    with pytest.raises(FileNotFoundError, match="check the path"):
        read_session(tmp_path / "none.mcap")
    (tmp_path / "bad.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(64))
    with pytest.raises(ValueError, match="MCAP file"):
        read_session(tmp_path / "bad.mcap")
    _, (mcap, _, _) = saved
    (tmp_path / "short.mcap").write_bytes(mcap.read_bytes()[:2000])
    with pytest.raises(ValueError, match="MCAP file"):
        read_session(tmp_path / "short.mcap")
    renderer = open_renderer(saved[0].operating_point, side=16)
    with pytest.raises(FileExistsError, match="left as it is"):
        export_session(
            mcap.with_suffix(""), saved[0].history.read(), renderer, {}, gain=1.0, small_renderer=renderer
        )
