"""Space behind every visitor's own window: what each sees, what a drag there does, and who is forgotten."""

import time
from contextlib import ExitStack

import numpy as np
import pytest

from lagsplat.config.compose import compose
from lagsplat.viewer.server.canvas import to_pixel
from lagsplat.viewer.server.server import ViewerContent, ViewerServer
from tests.unit.forces.solid import FRONT, turning
from tests.unit.viewer.sessions import session
from tests.unit.viewer.visitors import camera, dragged, send, visit

SIDE = 64
AHEAD = (0.0, 1.0, 0.0, 0.0)  # from in front, upright


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    settings = compose("system=toy", "viewer.port=0", f"viewer.window={SIDE}")
    frame = np.zeros((24, 32, 3), np.uint8)
    folder = tmp_path_factory.mktemp("windows")
    one = ViewerServer(
        ViewerContent(session(turning()), "plate", lambda number: frame, folder), settings.viewer
    )
    yield one
    one.stop()


def until(holds, patience_s: float = 10.0):
    end = time.monotonic() + patience_s
    while not (found := holds()) and time.monotonic() < end:
        time.sleep(0.02)
    return found


def front(live: ViewerServer, **changes) -> dict:
    """What a browser tells of a camera where the film's is."""
    eye, fov = live.stage.board.room.eye, live.stage.board.room.fov(1.0)
    return camera(**{"wxyz": AHEAD, "position": eye, "fov": fov, **changes})


def test_every_visitor_sees_space_from_a_side_of_their_own(live) -> None:
    board, q = live.stage.board, live.show.session.held.rest.numpy()
    live.loop.tell(lambda s: s.pause(True))
    with ExitStack() as stack:
        one, two = (stack.enter_context(visit(live)) for _ in range(2))
        send(one, front(live))
        assert until(lambda: len(live.server.get_clients()) == 1)
        near = tuple(0.7 * x for x in board.room.eye)
        send(two, front(live, position=near, image_width=200))
        assert until(lambda: len(board.seen) == 2)
        time.sleep(0.3)  # until the loop has nothing left to paint
        board.seen.clear()
        windows = board.paint(q).windows
        assert [window.picture.shape for window in windows] == [(SIDE, SIDE, 3), (SIDE // 2, SIDE, 3)]
        for window in windows:
            camera_of = board.camera(window.client)
            np.testing.assert_array_equal(window.picture, board.easel.seen(q, camera_of))
        assert board.paint(q).windows == []
        send(two, front(live))
        assert until(lambda: len(set(board.seen.values())) == 1)
    assert until(lambda: not board.seen)


def test_a_paused_picture_follows_the_camera(live) -> None:
    live.loop.tell(lambda s: s.pause(True))
    board = live.stage.board
    with visit(live) as client:
        send(client, front(live))
        assert until(lambda: board.seen)
        before = dict(board.seen)
        send(client, front(live, position=(0.0, 0.0, 3.0)))
        assert until(lambda: board.seen and board.seen != before)


def test_a_drag_on_the_matter_pulls_it_in_the_plane_of_the_screen_and_its_end_lets_go(live) -> None:
    one = live.show.session
    live.loop.tell(lambda s: (s.to_rest(), s.pause(True)))
    with visit(live) as client:
        send(client, front(live))
        assert until(lambda: len(live.server.get_clients()) == 1)
        for phase in ("start", "update"):
            send(client, dragged(phase, (0, 0, 0), (0, 0, 0), "/matter", start_screen_pos=(0.5, 0.5),
                                 end_screen_pos=(0.6, 0.5)))  # fmt: skip
        assert until(lambda: one.hand is not None and one.hand.force.any())
        np.testing.assert_allclose(one.hand.grip.at, (0.0, 0.0, FRONT), atol=1e-3)
        # a tenth of the window, at the depth of what was met
        way = 0.1 * 1.12 * 32 * FRONT / 100.0
        np.testing.assert_allclose(one.hand.force / one.touch.gain, (way, 0.0, 0.0), atol=1e-6)
    assert until(lambda: one.hand is None)


def test_a_drag_of_the_wall_or_of_nothing_pushes_nothing(live) -> None:
    one = live.show.session
    with visit(live) as client:
        send(client, front(live))
        assert until(lambda: len(live.server.get_clients()) == 1)
        for place in ((0.12, 0.3), (0.99, 0.01)):
            send(client, *(dragged(phase, (0, 0, 0), (0, 0, 0), "/matter", start_screen_pos=place,
                                   end_screen_pos=(0.5, 0.5)) for phase in ("start", "update")))  # fmt: skip
            heard = []
            live.loop.tell(lambda s, heard=heard: heard.append(s.hand))
            assert until(lambda heard=heard: heard)
            assert heard[0] is None or heard[0].still
    assert until(lambda: one.hand is None)


def test_the_outline_at_rest_is_drawn_around_the_plate_from_every_side(live) -> None:
    board = live.stage.board
    for yaw in (0.0, 0.6):
        turn = np.array([[np.cos(yaw), 0.0, np.sin(yaw)], [0.0, 1.0, 0.0], [-np.sin(yaw), 0.0, np.cos(yaw)]])
        position = board.room.pivot - 100.0 * turn[2]
        seen = board.easel.filmed.resized(48, 64)
        seen = type(seen)(turn, position, seen.focal, seen.middle, seen.height, seen.width)
        pixels = seen.project(board.silhouettes.outline(seen).reshape(-1, 3))
        middle = seen.project(np.array([[0.0, 0.0, FRONT]]))[0]
        across = 2 * 7.5 * np.array([np.cos(yaw), 1.0])
        np.testing.assert_allclose(np.abs(pixels - middle).max(0), across, atol=4.0)


@pytest.mark.parametrize(
    "place", [(np.nan, 0.5), ("a", 0.5), (0.5,), ({}, 1.0), None], ids=["nan", "text", "one", "map", "none"]
)
def test_a_pointer_that_is_nowhere_is_told(live, place) -> None:
    with pytest.raises(ValueError, match=r"no number|not on a screen|could not convert"):
        to_pixel(live.stage.board.easel.filmed, place)


def test_a_pointer_far_outside_counts_as_at_the_edge_of_what_a_hand_can_reach(live) -> None:
    filmed = live.stage.board.easel.filmed
    far = to_pixel(filmed, (1e308, -1e308))
    np.testing.assert_allclose(far, (1.5 * filmed.width, -0.5 * filmed.height))
