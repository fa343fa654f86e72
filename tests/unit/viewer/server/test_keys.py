"""What keys do to a session, what the page shows of it, and the script that keeps arrows from the camera."""

import gzip
import http.client
import time

import numpy as np
import pytest

from lagsplat.viewer.server import keys
from lagsplat.viewer.server.controls import DASHES
from lagsplat.viewer.server.server import ViewerServer
from tests.unit.forces.rocking import rocking
from tests.unit.forces.solid import turning
from tests.unit.viewer.sessions import session

FAR = 40.0  # deviations


@pytest.fixture(scope="module", params=[rocking, turning], ids=["picture", "space"])
def live(request, tmp_path_factory):
    one, frame = (
        session(request.param(), "viewer.port=0", "viewer.window=64"),
        np.zeros((24, 32, 3), np.uint8),
    )
    server = ViewerServer(
        one, title="disc", read_frame=lambda number: frame, folder=tmp_path_factory.mktemp("keys")
    )
    yield server
    server.stop()


def until(holds, patience_s: float = 20.0):
    end = time.monotonic() + patience_s
    while not (found := holds()) and time.monotonic() < end:
        time.sleep(0.02)
    return found


def test_an_arrow_pushes_that_way_until_shortly_after(live) -> None:
    assert live.scene_view.hint.visible, "nobody has pushed yet"
    live.panel.keys.press(keys.ARROWS["right"])
    grasp = until(lambda: live.session.active_grasp)
    assert until(lambda: grasp.force[0] > 0.0 or live.session.active_grasp.force[0] > 0.0)
    assert until(lambda: not live.scene_view.hint.visible)
    assert until(lambda: live.session.active_grasp is None)


def test_an_arrow_does_not_take_the_object_from_a_hand(live) -> None:
    one, place = live.session, live.panel.keys.find_target(live.session)
    live.loop.submit(lambda s: (s.grasp(place), s.pull(-np.eye(len(place))[0])))
    assert until(lambda: one.active_grasp is not None and one.active_grasp.force[0] < 0.0)
    live.panel.keys.press(keys.ARROWS["right"])
    time.sleep(keys.HOLD_S + 0.5)
    assert one.active_grasp is not None
    assert one.active_grasp.force[0] < 0.0
    live.loop.submit(lambda s: s.release())


def test_a_state_beyond_the_recording_is_framed(live) -> None:
    live.loop.submit(lambda s: (s.to_rest(), s.pause(True)))
    assert until(lambda: not live.scene_view.beyond.visible)
    live.loop.submit(lambda s: setattr(s, "q", s.q + FAR))
    assert until(lambda: live.scene_view.beyond.visible)
    live.loop.submit(lambda s: (s.to_rest(), s.pause(False)))
    assert until(lambda: not live.scene_view.beyond.visible)


def test_lines_of_plots_differ_without_their_colours_and_coordinates_count_from_one(live) -> None:
    (state, d), _, (flows, n) = live.panel.plots.plots
    assert [line["label"] for line in state.series[1:]] == [f"q{i + 1}" for i in range(d)]
    assert [line["dash"] for line in flows.series[1:]] == list(DASHES[:n])
    assert ("inputs" in [line["label"] for line in flows.series]) == (len(live.session.u) > 0)


@pytest.mark.parametrize("encoding", ["gzip", "identity"])
def test_the_page_keeps_arrows_from_the_camera(live, encoding: str) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", live.server.get_port(), timeout=10)
    connection.request("GET", f"/{live.gate.token}/", headers={"Accept-Encoding": encoding})
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    assert answer.getheader("Content-Length") == str(len(body))
    page = gzip.decompress(body) if encoding == "gzip" else body
    assert page.count(b"arrow keys that push") == 1
    assert page.rstrip().endswith(b"</html>")
