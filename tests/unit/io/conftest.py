"""A web server on this machine that fails on demand."""

import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np
import pytest


@dataclass
class Site:
    """What the server holds and how it behaves; ``asked`` lists the ``Range`` of every request.

    ``cut_after``: bytes after which each of the next answers breaks off. ``statuses``: sent instead of
    the next answers.
    """

    content: bytes
    ranges: bool = True
    cut_after: list[int] = field(default_factory=list)
    statuses: list[int] = field(default_factory=list)
    announce: bool = True
    asked: list[str | None] = field(default_factory=list)
    url: str = ""


class Server(ThreadingHTTPServer):
    def handle_error(self, request: Any, client_address: Any) -> None:
        """Broken connections are the point here; nothing is printed."""


@contextmanager
def serve(site: Site) -> Iterator[Site]:
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            answer(self, site)

        def log_message(self, format: str, *args: Any) -> None:
            pass

    server = Server(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    site.url = f"http://127.0.0.1:{server.server_port}/files/data.bin"
    try:
        yield site
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def answer(handler: BaseHTTPRequestHandler, site: Site) -> None:
    asked = handler.headers.get("Range")
    site.asked.append(asked)
    if site.statuses:
        handler.send_error(site.statuses.pop(0))
        return
    total, start = len(site.content), 0
    match = re.fullmatch(r"bytes=(\d+)-", asked or "")
    if match and site.ranges:
        start = int(match[1])
        if start >= total:
            handler.send_response(416)
            handler.send_header("Content-Range", f"bytes */{total}")
            handler.send_header("Content-Length", "0")
            handler.end_headers()
            return
        handler.send_response(206)
        handler.send_header("Content-Range", f"bytes {start}-{total - 1}/{total}")
    else:
        handler.send_response(200)
    body = site.content[start:]
    if site.announce:
        handler.send_header("Content-Length", str(len(body)))
    handler.end_headers()
    handler.wfile.write(body[: site.cut_after.pop(0)] if site.cut_after else body)


@pytest.fixture
def site() -> Iterator[Site]:
    """A server with a megabyte of noise."""
    content = np.random.default_rng(0).integers(0, 256, 1_000_003, dtype=np.uint8).tobytes()
    with serve(Site(content)) as running:
        yield running
