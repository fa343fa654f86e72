"""The handshake of the live view: who is let in, how many, how fast, and who is dropped."""

import http.client
import logging
import socket
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import viser
from viser import _messages as messages
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

from lagsplat.viewer.server import handshake
from lagsplat.viewer.server.handshake import MOST_VISITORS, Allowance, Gate, guard_sockets
from lagsplat.viewer.server.server import ViewerServer
from lagsplat.viewer.simulation.realtime_loop import MOST_WAITING
from tests.unit.forces.rocking import rocking
from tests.unit.viewer.sessions import session
from tests.unit.viewer.visitors import PROTOCOL, camera, dragged, send, visit

PATIENCE_S = 30.0
UPGRADE = (
    "GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n"
    "Sec-WebSocket-Protocol: {protocol}\r\n\r\n"
)


def opened(folder: Path) -> ViewerServer:
    one, frame = session(rocking(), "viewer.port=0", "viewer.window=64"), np.zeros((24, 32, 3), np.uint8)
    return ViewerServer(one, title="disc", read_frame=lambda number: frame, folder=folder)


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    one = opened(tmp_path_factory.mktemp("live"))
    yield one
    one.stop()


@pytest.fixture(autouse=True)
def rested(live) -> None:
    live.gate.sockets = Allowance(1e6, 1e6)


def ask(live: ViewerServer, path: str, **headers: str) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection("127.0.0.1", live.server.get_port(), timeout=10)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    answer.text = answer.read()
    connection.close()
    return answer


def visitors_of(live: ViewerServer) -> int:
    return len(live.server._websock_server._live_connections)


def until(holds) -> bool:
    end = time.monotonic() + PATIENCE_S
    while not (found := holds()) and time.monotonic() < end:
        time.sleep(0.05)
    return bool(found)


@pytest.mark.parametrize(
    ("path", "status"),
    [
        ("/", 403),
        ("/wrong/", 403),
        ("/{token}x/", 403),
        ("//{token}/", 403),
        ("/{token}?", 200),
        ("/{token}/", 200),
    ],
)
def test_nothing_is_served_without_the_token(live, path: str, status: int) -> None:
    answer = ask(live, path.format(token=live.gate.token))
    assert answer.status == status
    assert (b"Open the whole address" in answer.text) == (status == 403)


def test_a_path_that_is_no_text_is_refused(live) -> None:
    with socket.create_connection(("127.0.0.1", live.server.get_port()), timeout=PATIENCE_S) as client:
        client.sendall(b"GET /\xff\xfe/ HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        assert b" 403 " in client.recv(4096)


def test_a_socket_without_the_token_is_refused_in_the_handshake(live) -> None:
    with pytest.raises(InvalidStatus, match="403"):
        connect(f"ws://127.0.0.1:{live.server.get_port()}", subprotocols=[PROTOCOL])
    assert visitors_of(live) == 0


def test_two_servers_have_two_tokens() -> None:
    tokens = {Gate(loopback_only=True).token for _ in range(100)}
    assert len(tokens) == 100
    assert min(map(len, tokens)) >= 24


@pytest.mark.parametrize("path", ["/{token}/", "/"], ids=["the page", "a refusal"])
def test_no_page_may_frame_or_read_an_answer(live, path: str) -> None:
    answer = ask(live, path.format(token=live.gate.token))
    assert answer.headers["X-Frame-Options"] == "DENY"
    policy = answer.headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "frame-ancestors 'none'" in policy
    assert "'unsafe-eval'" not in policy
    assert answer.headers["Referrer-Policy"] == "no-referrer"


@pytest.mark.parametrize(
    "headers", [{"Host": "evil.example"}, {"Origin": "http://evil.example"}, {"Origin": "null"}]
)
def test_a_foreign_page_that_knows_the_token_is_refused(
    live, headers: dict[str, str], caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        assert ask(live, f"/{live.gate.token}/", **headers).status == 403
    assert "was turned away" in caplog.text
    assert live.gate.token not in caplog.text


def test_the_page_of_the_server_and_a_program_are_let_in(live) -> None:
    for origin in (live.url.partition(f"/{live.gate.token}")[0], None):
        with visit(live, origin=origin) as client:
            assert client.recv(timeout=10)


def test_there_is_room_for_so_many_visitors_and_no_more(live) -> None:
    visitors = [visit(live) for _ in range(MOST_VISITORS)]
    with pytest.raises(InvalidStatus, match="503"):
        visit(live)
    visitors.pop().close()
    assert until(lambda: visitors_of(live) < MOST_VISITORS)
    visit(live).close()
    for visitor in visitors:
        visitor.close()


def test_new_visitors_come_one_after_the_other(live) -> None:
    live.gate.sockets = Allowance(2.0, 3.0)
    for _ in range(3):
        visit(live).close()
    with pytest.raises(InvalidStatus, match="429"):
        visit(live)
    time.sleep(0.6)
    visit(live).close()


def test_an_allowance_is_spent_and_comes_back(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    allowance = Allowance(10.0, 2.0)
    assert [allowance.take() for _ in range(4)] == pytest.approx([0.0, 0.0, 0.1, 0.2])
    now[0] = 0.4
    assert allowance.take() == 0.0
    now[0] = 100.0
    assert [allowance.take() for _ in range(3)] == pytest.approx([0.0, 0.0, 0.1]), "no more than at once"


def test_a_flood_of_drags_is_slowed_and_others_are_not(live, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(handshake, "MESSAGES_HZ", 50.0)
    monkeypatch.setattr(handshake, "MESSAGES_AT_ONCE", 20.0)
    heard: dict[int, int] = {}

    def count(client: int, message: object) -> None:
        heard[client] = heard.get(client, 0) + 1

    sockets = live.server._websock_server
    sockets.register_handler(messages.SceneNodeDragMessage, count)
    drag = dragged("update", (0, 0, 0), (1, 0, 0))
    try:
        with visit(live) as flood, visit(live) as other:
            send(flood, camera())
            began = time.monotonic()
            send(flood, *[drag] * 150)
            time.sleep(1.0)
            send(other, camera(), drag)
            assert until(lambda: len(heard) == 2), "the other visitor is heard"
            passed_s = time.monotonic() - began
            first, second = (heard[client] for client in sorted(heard))
            assert second == 1
            assert 20 <= first <= 20 + 50.0 * passed_s + 1, "none of them is lost, but they wait"
    finally:
        sockets.unregister_handler(messages.SceneNodeDragMessage, count)


def test_messages_wait_while_the_simulation_is_behind(live, monkeypatch: pytest.MonkeyPatch) -> None:
    heard: list[object] = []

    def keep(client: int, message: object) -> None:
        heard.append(message)

    assert until(lambda: visitors_of(live) == 0), "visitors of other tests have sent what they had"
    sockets = live.server._websock_server
    sockets.register_handler(messages.SceneNodeDragMessage, keep)
    try:
        with monkeypatch.context() as patched, visit(live) as client:
            patched.setattr(live.gate, "is_behind", lambda: True)
            send(client, camera(), *[dragged("update", (0, 0, 0), (1, 0, 0))] * 5)
            time.sleep(0.5)
            assert heard == []
            patched.undo()
            assert until(lambda: len(heard) == 5), "they have waited, and none is lost"
    finally:
        sockets.unregister_handler(messages.SceneNodeDragMessage, keep)


def test_what_waits_is_what_the_simulation_has_not_taken(live) -> None:
    assert not live.gate.is_behind()
    going_on = threading.Event()
    live.loop.submit(lambda s: going_on.wait(PATIENCE_S))
    for _ in range(MOST_WAITING + 1):
        live.loop.submit(lambda s: None)
    assert live.gate.is_behind()
    going_on.set()
    assert until(lambda: not live.gate.is_behind())


@pytest.fixture
def impatient(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for name in ("open_timeout", "ping_interval", "ping_timeout", "close_timeout"):
        monkeypatch.setitem(handshake.LIMITS, name, 0.5)
    one = opened(tmp_path)
    yield one
    one.stop()


@pytest.mark.parametrize("sent", ["", "GET / HTTP/1.1\r\nHost: "], ids=["silent", "slow"])
def test_a_handshake_that_does_not_come_is_not_waited_for(impatient, sent: str) -> None:
    with socket.create_connection(("127.0.0.1", impatient.server.get_port()), timeout=PATIENCE_S) as client:
        client.sendall(sent.encode())
        began = time.monotonic()
        assert client.recv(4096) == b""
        assert time.monotonic() - began < 10.0


def test_a_visitor_who_answers_no_ping_and_reads_nothing_is_dropped(impatient) -> None:
    with socket.socket() as client:
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        client.connect(("127.0.0.1", impatient.server.get_port()))
        path = f"/{impatient.gate.token}/"
        client.sendall(UPGRADE.format(path=path, protocol=PROTOCOL).encode())
        assert until(lambda: visitors_of(impatient) == 1)
        assert until(lambda: visitors_of(impatient) == 0), "a client that stands still stays"


def test_one_who_answers_pings_stays(impatient) -> None:
    with visit(impatient) as client:
        assert until(lambda: visitors_of(impatient) == 1)
        end = time.monotonic() + 3.0
        while time.monotonic() < end:
            try:
                client.recv(timeout=0.2)
            except TimeoutError:
                continue
            except ConnectionClosed:
                pytest.fail("dropped although it answers")
        assert visitors_of(impatient) == 1


def test_a_viser_that_cannot_be_guarded_does_not_serve() -> None:
    with (
        pytest.raises(RuntimeError, match=f"viser {viser.__version__} opens its socket"),
        guard_sockets(Gate(loopback_only=True)),
    ):
        pass
