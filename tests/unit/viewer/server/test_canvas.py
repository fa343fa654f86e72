"""Canvases in space: the view of each visitor and drags in it."""

import time
from contextlib import ExitStack

import numpy as np
import pytest

from lagsplat.viewer.server.canvas import to_pixel
from lagsplat.viewer.server.server import ViewerServer
from tests.unit.forces.solid import FRONT, turning
from tests.unit.viewer.sessions import session
from tests.unit.viewer.visitors import camera, dragged, send, visit

SIDE = 64
AHEAD = (0.0, 1.0, 0.0, 0.0)  # from in front, upright


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    plate = session(turning(), "viewer.port=0", f"viewer.window={SIDE}")
    frame = np.zeros((24, 32, 3), np.uint8)
    folder = tmp_path_factory.mktemp("windows")
    one = ViewerServer(plate, title="plate", read_frame=lambda number: frame, folder=folder)
    yield one
    one.stop()


def until(holds, patience_s: float = 10.0):
    end = time.monotonic() + patience_s
    while not (found := holds()) and time.monotonic() < end:
        time.sleep(0.02)
    return found


def front(live: ViewerServer, **changes) -> dict:
    """What a browser tells of a camera where the film's is."""
    eye, fov = live.scene_view.canvas.scene_frame.eye, live.scene_view.canvas.scene_frame.fov(1.0)
    return camera(**{"wxyz": AHEAD, "position": eye, "fov": fov, **changes})


def test_every_visitor_sees_the_view_of_their_own_camera(live) -> None:
    canvas, q = live.scene_view.canvas, live.session.operating_point.rest.numpy()
    live.loop.submit(lambda s: s.pause(True))
    with ExitStack() as stack:
        one, two = (stack.enter_context(visit(live)) for _ in range(2))
        send(one, front(live))
        assert until(lambda: len(live.server.get_clients()) == 1)
        near = tuple(0.7 * x for x in canvas.scene_frame.eye)
        send(two, front(live, position=near, image_width=200))
        assert until(lambda: len(canvas.drawn_keys) == 2)
        time.sleep(0.3)  # until the loop has nothing left to paint
        canvas.drawn_keys.clear()
        windows = canvas.paint(q).windows
        assert [window.image.shape for window in windows] == [(SIDE, SIDE, 3), (SIDE // 2, SIDE, 3)]
        for window in windows:
            camera_of = canvas.camera(window.client)
            np.testing.assert_array_equal(window.image, canvas.renderer.render_view(q, camera_of))
        assert canvas.paint(q).windows == []
        send(two, front(live))
        assert until(lambda: len(set(canvas.drawn_keys.values())) == 1)
    assert until(lambda: not canvas.drawn_keys)


def test_a_paused_view_follows_the_camera(live) -> None:
    live.loop.submit(lambda s: s.pause(True))
    canvas = live.scene_view.canvas
    with visit(live) as client:
        send(client, front(live))
        assert until(lambda: canvas.drawn_keys)
        before = dict(canvas.drawn_keys)
        send(client, front(live, position=(0.0, 0.0, 3.0)))
        assert until(lambda: canvas.drawn_keys and canvas.drawn_keys != before)


def test_a_drag_on_the_object_pulls_in_the_plane_of_the_screen_and_its_end_releases(live) -> None:
    one = live.session
    live.loop.submit(lambda s: (s.to_rest(), s.pause(True)))
    with visit(live) as client:
        send(client, front(live))
        assert until(lambda: len(live.server.get_clients()) == 1)
        for phase in ("start", "update"):
            send(
                client,
                dragged(
                    phase,
                    (0, 0, 0),
                    (0, 0, 0),
                    "/matter",
                    start_screen_pos=(0.5, 0.5),
                    end_screen_pos=(0.55, 0.5),
                ),
            )
        assert until(lambda: one.active_grasp is not None and one.active_grasp.force.any())
        np.testing.assert_allclose(one.active_grasp.grasp_point.at, (0.0, 0.0, FRONT), atol=1e-3)
        # a twentieth of the window, at the depth of what was met
        displacement = 0.05 * 1.12 * 32 * FRONT / 100.0
        np.testing.assert_allclose(
            one.active_grasp.force / one.active_grasp.gain, (displacement, 0.0, 0.0), atol=1e-6
        )
    assert until(lambda: one.active_grasp is None)


def test_a_drag_of_the_wall_or_of_nothing_pushes_nothing(live) -> None:
    one = live.session
    with visit(live) as client:
        send(client, front(live))
        assert until(lambda: len(live.server.get_clients()) == 1)
        for place in ((0.12, 0.3), (0.99, 0.01)):
            send(
                client,
                *(
                    dragged(
                        phase,
                        (0, 0, 0),
                        (0, 0, 0),
                        "/matter",
                        start_screen_pos=place,
                        end_screen_pos=(0.5, 0.5),
                    )
                    for phase in ("start", "update")
                ),
            )
            heard = []
            live.loop.submit(lambda s, heard=heard: heard.append(s.active_grasp))
            assert until(lambda heard=heard: heard)
            assert heard[0] is None or heard[0].is_background
    assert until(lambda: one.active_grasp is None)


def test_the_outline_at_rest_is_drawn_around_the_plate_from_every_side(live) -> None:
    canvas = live.scene_view.canvas
    for yaw in (0.0, 0.6):
        turn = np.array([[np.cos(yaw), 0.0, np.sin(yaw)], [0.0, 1.0, 0.0], [-np.sin(yaw), 0.0, np.cos(yaw)]])
        position = canvas.scene_frame.pivot - 100.0 * turn[2]
        seen = canvas.renderer.recording_camera.resized(48, 64)
        seen = type(seen)(turn, position, seen.focal, seen.middle, seen.height, seen.width)
        pixels = seen.project(canvas.silhouettes.trace(seen).reshape(-1, 3))
        middle = seen.project(np.array([[0.0, 0.0, FRONT]]))[0]
        across = 2 * 7.5 * np.array([np.cos(yaw), 1.0])
        np.testing.assert_allclose(np.abs(pixels - middle).max(0), across, atol=4.0)


@pytest.mark.parametrize(
    "place", [(np.nan, 0.5), ("a", 0.5), (0.5,), ({}, 1.0), None], ids=["nan", "text", "one", "map", "none"]
)
def test_an_invalid_pointer_is_refused(live, place) -> None:
    with pytest.raises(ValueError, match=r"no number|not on a screen|could not convert"):
        to_pixel(live.scene_view.canvas.renderer.recording_camera, place)


def test_a_pointer_far_outside_the_window_is_clipped(live) -> None:
    filmed = live.scene_view.canvas.renderer.recording_camera
    far = to_pixel(filmed, (1e308, -1e308))
    np.testing.assert_allclose(far, (1.5 * filmed.width, -0.5 * filmed.height))
