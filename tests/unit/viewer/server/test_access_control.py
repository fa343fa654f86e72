"""Access control: no hostile message executes code, ends the session or moves a file."""

import http.client
import socket
import threading
import time

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus

from lagsplat.cli.main import main
from lagsplat.config.compose import compose
from lagsplat.viewer.server.access_control import is_foreign_origin, warn_of_open_host
from lagsplat.viewer.server.handshake import Allowance
from lagsplat.viewer.server.server import ViewerServer
from tests.unit.forces.rocking import rocking
from tests.unit.forces.solid import turning
from tests.unit.viewer.sessions import session
from tests.unit.viewer.visitors import camera, dragged, hostile, send, visit

FLAT, SPACE = "/picture", "/matter"


def opened(operating_point, folder):
    one = session(operating_point, "viewer.port=0", "viewer.window=64")
    frame = np.zeros((24, 32, 3), np.uint8)
    live = ViewerServer(one, title="disc", read_frame=lambda number: frame, folder=folder)
    live.gate.sockets = Allowance(1e6, 1e6)  # every hostile message comes by a socket of its own
    return live


@pytest.fixture(scope="module", params=[FLAT, SPACE], ids=["picture", "space"])
def any_live(request, tmp_path_factory):
    """A live page, and the name of what can be dragged there."""
    operating_point = rocking() if request.param == FLAT else turning()
    one = opened(operating_point, tmp_path_factory.mktemp("live"))
    yield one, request.param
    one.stop()


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    one = opened(rocking(), tmp_path_factory.mktemp("live"))
    yield one
    one.stop()


def test_no_message_executes_anything_ends_the_session_or_moves_a_file(
    any_live, tmp_path, monkeypatch
) -> None:
    live, name = any_live
    monkeypatch.chdir(tmp_path)
    handles = live.server.gui._gui_input_handle_from_uuid
    callbacks = {uuid: list(handle._impl.update_cb) for uuid, handle in handles.items()}
    for message in hostile(live, name):
        try:
            with visit(live) as client:
                send(client, camera())
                client.send(message)
                time.sleep(0.002)
        except ConnectionClosed:
            pass
    heard = threading.Event()
    live.loop.submit(lambda s: (s.to_rest(), heard.set()))
    assert heard.wait(10.0)
    one, steps = live.session, live.session.steps
    live.loop.submit(lambda s: s.pause(False))
    time.sleep(0.3)
    assert one.steps > steps
    assert np.isfinite(one.q).all()
    assert {uuid: list(handle._impl.update_cb) for uuid, handle in handles.items()} == callbacks
    assert live.server._share_tunnel is None
    assert list(tmp_path.iterdir()) == []
    began = time.monotonic()
    while list(live.folder.glob(".*")) and time.monotonic() - began < 20.0:
        time.sleep(0.05)  # a file is hidden until it is whole
    assert {path.stem.rstrip("0123456789") for path in live.folder.glob("*.mcap")} <= {"session_"}
    assert {path.suffix for path in live.folder.iterdir()} <= {".mcap", ".mp4", ".gif"}


def test_a_drag_still_pushes_after_hostile_messages(live) -> None:
    grab = tuple(live.scene_view.canvas.image_plane.to_scene(np.array([16.0, 8.0])).tolist())
    tip = tuple(live.scene_view.canvas.image_plane.to_scene(np.array([18.0, 8.0])).tolist())
    with visit(live) as client:
        send(client, camera())
        time.sleep(0.3)
        send(client, *(dragged(phase, grab, tip) for phase in ("start", "update")))
        end = time.monotonic() + 10.0
        # the grasp begins without a force; the drag that follows gives it one
        while not ((grasp := live.session.active_grasp) and grasp.force.any()) and time.monotonic() < end:
            time.sleep(0.02)
        np.testing.assert_allclose(live.session.active_grasp.grasp_point.at, (16.0, 8.0), atol=1e-6)
        np.testing.assert_allclose(
            live.session.active_grasp.force, (2.0 * live.session.active_grasp.gain, 0.0)
        )
    end = time.monotonic() + 10.0
    while live.session.active_grasp is not None and time.monotonic() < end:
        time.sleep(0.02)
    assert live.session.active_grasp is None


def test_a_page_of_another_site_is_refused(live) -> None:
    with pytest.raises(InvalidStatus, match="403"):
        visit(live, origin="http://evil.example")
    with visit(live, origin=live.url) as client:
        assert client.recv(timeout=10)


@pytest.mark.parametrize(
    ("origin", "host", "loopback_only", "expected"),
    [
        (None, "127.0.0.1:8080", True, False),
        ("http://localhost:8080", "localhost:8080", True, False),
        ("http://evil.example:8080", "localhost:8080", True, True),
        ("http://evil.example:8080", "evil.example:8080", True, True),
        ("http://robot.example:8080", "robot.example:8080", False, False),
        ("null", "localhost:8080", True, True),
        (None, None, True, True),
    ],
    ids=["program", "own", "other site", "name that points here", "network", "file", "no host"],
)
def test_foreign_origins_are_recognised(origin, host, loopback_only, expected) -> None:
    headers = {key: value for key, value in (("Origin", origin), ("Host", host)) if value is not None}
    assert is_foreign_origin(headers, loopback_only=loopback_only) is expected


@pytest.mark.parametrize("path", ["/../../../../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "/..\\..\\etc"])
def test_files_outside_the_page_are_not_served(live, path: str) -> None:
    connection = http.client.HTTPConnection("127.0.0.1", live.server.get_port(), timeout=10)
    connection.request("GET", f"/{live.gate.token}{path}")
    answer = connection.getresponse()
    assert b"root:" not in answer.read()
    assert answer.status in (403, 404)


def test_the_server_listens_on_loopback_and_warns_about_any_other_host() -> None:
    assert compose("system=toy").viewer.host == "127.0.0.1"
    assert (
        warn_of_open_host("127.0.0.1") is warn_of_open_host("::1") is warn_of_open_host("localhost") is None
    )
    for host in ("0.0.0.0", "192.168.1.4", "robot.example"):
        assert "plain text" in (warn_of_open_host(host) or "")


def test_an_address_of_another_machine_is_refused_at_once(tmp_path) -> None:
    one, frame = session(None, "viewer.host=203.0.113.9"), np.zeros((24, 32, 3), np.uint8)
    with pytest.raises(OSError, match=r"viewer.host=203.0.113.9: .*this machine"):
        ViewerServer(one, title="disc", read_frame=lambda number: frame, folder=tmp_path)


def test_the_socket_is_bound_to_loopback(live) -> None:
    outside = socket.gethostbyname(socket.gethostname())
    if outside.startswith("127."):
        pytest.skip("this machine has no other address than loopback")
    with pytest.raises(OSError, match=r".+"):
        socket.create_connection((outside, live.server.get_port()), timeout=2).close()


def test_the_command_names_what_a_run_lacks(tmp_path, capsys) -> None:
    assert main(["view", str(tmp_path / "nothing"), "--no-browser"]) == 2
    assert "name a finished fit" in capsys.readouterr().err
    assert main(["view"]) == 2
    assert "name one fitted run" in capsys.readouterr().err
    assert main(["view", str(tmp_path), "stage1.steps=3"]) == 2
    assert "viewer.key" in capsys.readouterr().err
