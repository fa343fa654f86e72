"""A page of another origin in a real browser: it knows the address, and none of its drags gets through."""

import base64
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import msgspec
import numpy as np
import pytest
from viser import _messages as messages

from lagsplat.viewer.server.handshake import Allowance
from lagsplat.viewer.server.server import ViewerServer
from tests.browser.chromium import browser, until
from tests.browser.disc import disc
from tests.browser.live_page import opened
from tests.unit.viewer.visitors import PROTOCOL, camera, dragged

SOCKETS, DRAGS = 10, 100  # a thousand drags in all
# Each socket sends its drags as soon as it opens; the answer says how many were handed to open sockets.
ATTACK = """([url, protocol, texts, sockets, drags]) => {
  const [camera, drag] = texts.map((text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)));
  const attempts = Array.from({ length: sockets }, () => new Promise((settle) => {
    const socket = new WebSocket(url, [protocol]);
    let sent = 0;
    socket.onopen = () => {
      socket.send(camera);
      for (; sent < drags; ++sent) socket.send(drag);
    };
    socket.onerror = socket.onclose = () => settle(sent);
    setTimeout(() => settle(sent), 20000);
    window.kept = [...(window.kept ?? []), socket];
    if (sockets === 1) setTimeout(() => settle(sent), 3000);
  }));
  return Promise.all(attempts).then((counts) => counts.reduce((a, b) => a + b, 0));
}"""
FRAMED = """(url) => new Promise((settle) => {
  const frame = document.createElement("iframe");
  frame.onload = () => settle(frame.contentWindow.length);
  frame.src = url;
  document.body.append(frame);
})"""


@pytest.fixture(scope="module")
def live(tmp_path_factory):
    session = disc("viewer.port=0", "viewer.pictures_hz=6", "viewer.side=48")
    frame = np.full((24, 32, 3), 90, np.uint8)
    folder = tmp_path_factory.mktemp("live")
    one = ViewerServer(session, title="Disc", read_frame=lambda number: frame, folder=folder)
    one.gate.sockets = Allowance(1e6, 1e6)  # who is refused is not refused for haste
    yield one
    one.stop()


@pytest.fixture(scope="module")
def chromium():
    with browser() as one:
        yield one


@pytest.fixture
def heard(live) -> Iterator[list[int]]:
    """Visitors of whom the server hears a drag, once for each."""
    clients: list[int] = []

    def note(client: int, message: object) -> None:
        clients.append(client)

    sockets = live.server._websock_server
    sockets.register_handler(messages.SceneNodeDragMessage, note)
    yield clients
    sockets.unregister_handler(messages.SceneNodeDragMessage, note)


@contextmanager
def another_site() -> Iterator[int]:
    """A server of another program; its port."""

    class Page(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(b"<!doctype html><title>another site</title><body>")

        def log_message(self, *words: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Page) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield server.server_port
        finally:
            server.shutdown()
            thread.join()


def attack(page, live: ViewerServer, sockets: int) -> int:
    grab, tip = (live.scene_view.canvas.image_plane.to_scene(np.array([x, 8.0])) for x in (16.0, 18.0))
    sent = [camera(), dragged("start", tuple(grab.tolist()), tuple(tip.tolist()))]
    texts = [base64.b64encode(msgspec.msgpack.encode(message)).decode() for message in sent]
    url = live.url.replace("http", "ws")
    count: int = page.evaluate(ATTACK, [url, str(PROTOCOL), texts, sockets, DRAGS])
    return count


@pytest.mark.parametrize("name", ["127.0.0.1", "localhost"])
def test_none_of_a_thousand_drags_of_another_origin_gets_through(chromium, live, heard, name: str) -> None:
    with another_site() as port:
        page = chromium.new_page()
        page.goto(f"http://{name}:{port}/")
        assert attack(page, live, SOCKETS) == 0, "a socket was opened"
        page.close()
    assert heard == []
    assert live.session.active_grasp is None


def test_the_same_drags_of_the_own_page_get_through(chromium, live, heard) -> None:
    page = opened(chromium, live)
    assert attack(page, live, 1) == DRAGS
    until(lambda: len(heard) == DRAGS, "the drags")
    page.close()
    until(lambda: live.session.active_grasp is None, "the release")


def test_a_name_of_another_site_that_points_here_is_refused(chromium, live) -> None:
    page = chromium.new_page()
    answer = page.goto(live.url.replace("127.0.0.1", "evil.localhost"))
    assert answer.status == 403
    assert "Other origins are not served" in page.content()
    page.close()


def test_another_site_cannot_frame_the_page(chromium, live) -> None:
    with another_site() as port:
        page, refusals = chromium.new_page(), []
        page.on("console", lambda message: refusals.append(message.text))
        page.goto(f"http://127.0.0.1:{port}/")
        page.evaluate(FRAMED, live.url)
        assert any("frame" in text.lower() for text in refusals), refusals
        assert not live.server._websock_server._live_connections
        page.close()
