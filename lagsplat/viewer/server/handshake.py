"""Who may open a socket to the live view, decided before any message is read, and how much one may send.

viser opens its socket by `websockets.asyncio.server.serve` and has no place for a check of its own before the
handshake, so `guard_sockets` stands in for that function while viser starts. The page is at a path that is a
secret, the token: viser's page connects to where it came from, so its socket carries the token as well.
"""

import logging
import secrets
import time
from asyncio import sleep
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from http import HTTPStatus
from typing import Any

import viser
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response
from websockets.typing import Data

from lagsplat.viewer.server.access_control import is_foreign_origin
from lagsplat.viewer.server.page_script import add_page_script

log = logging.getLogger(__name__)
TOKEN_BYTES = 18
MOST_VISITORS = 16  # open sockets at once
SOCKETS_HZ, SOCKETS_AT_ONCE = 5.0, 20.0  # new ones
MESSAGES_HZ, MESSAGES_AT_ONCE = 240.0, 480.0  # of one visitor; a page sends a drag and a camera a picture
BEHIND_S = 0.01  # between two looks whether the simulation is behind [s]
LIMITS = {
    "open_timeout": 5.0,  # for the whole handshake [s]
    # A visitor who is silent, or so slow that a ping waits behind other data, is dropped.
    "ping_interval": 5.0,  # [s]
    "ping_timeout": 10.0,  # [s]
    "close_timeout": 2.0,  # [s]
    "max_size": 2**20,  # of a message [bytes]
}
HEADERS = {
    # The page is one file whose scripts are inside, with workers and WebAssembly that it makes itself.
    "Content-Security-Policy": "default-src 'none'; "
    "script-src 'unsafe-inline' 'wasm-unsafe-eval' blob: data:; "
    "worker-src blob: data:; style-src 'unsafe-inline'; img-src 'self' data: blob:; font-src data:; "
    "connect-src 'self' data: blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "X-Frame-Options": "DENY",
    "X-Content-Type-Options": "nosniff",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",  # the address is a secret
    "Cache-Control": "no-store",
}


@dataclass
class Allowance:
    """How often something may happen: ``rate_hz``, and ``at_once`` after a pause."""

    rate_hz: float
    at_once: float
    left: float = field(init=False)
    asked_s: float = field(init=False)

    def __post_init__(self) -> None:
        self.left, self.asked_s = self.at_once, time.monotonic()

    def take(self) -> float:
        """Count one more; returns how long it has to wait [s], 0 within the allowance."""
        now = time.monotonic()
        self.left = min(self.at_once, self.left + (now - self.asked_s) * self.rate_hz) - 1.0
        self.asked_s = now
        return max(0.0, -self.left / self.rate_hz)

    def give_back(self) -> None:
        """Take back the last one, which did not happen."""
        self.left += 1.0


class VisitorConnection(ServerConnection):
    """A socket from which messages are read no faster than a page sends them; the sender waits.

    Nor are they read faster than the simulation, which ``is_behind`` asks, takes what all visitors send.
    """

    def __init__(self, is_behind: Callable[[], bool], *words: Any, **settings: Any) -> None:
        super().__init__(*words, **settings)
        self.is_behind, self.allowance = is_behind, Allowance(MESSAGES_HZ, MESSAGES_AT_ONCE)

    async def recv(self, decode: bool | None = None) -> Data:  # type: ignore[override]
        """The next message, as `ServerConnection.recv`, once there is an allowance for it."""
        message = await super().recv(decode)
        await sleep(self.allowance.take())
        while self.is_behind():
            await sleep(BEHIND_S)
        return message


@dataclass
class Gate:
    """Lets in who knows the token, from a page of this server or from none, while there is room.

    ``loopback_only`` is true for a server that listens on loopback. ``is_behind`` tells whether messages have
    to wait.
    """

    loopback_only: bool
    is_behind: Callable[[], bool] = lambda: False
    token: str = field(default_factory=lambda: secrets.token_urlsafe(TOKEN_BYTES))
    sockets: Allowance = field(default_factory=lambda: Allowance(SOCKETS_HZ, SOCKETS_AT_ONCE))

    def refuse(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return the answer to a request that is refused, None to one that is not."""
        origin = request.headers.get("Origin")
        if is_foreign_origin(request.headers, loopback_only=self.loopback_only):
            log.warning("a page of %s was turned away", origin)
            return connection.respond(HTTPStatus.FORBIDDEN, "Other origins are not served.\n")
        if not secrets.compare_digest(self.token.encode(), _first_part(request)):
            text = "Open the whole address that the server has printed; a part of it is the password.\n"
            return connection.respond(HTTPStatus.FORBIDDEN, text)
        if "Upgrade" in request.headers:
            if len(connection.server.connections) >= MOST_VISITORS:
                text = f"{MOST_VISITORS} visitors are here already; close another page.\n"
                return connection.respond(HTTPStatus.SERVICE_UNAVAILABLE, text)
            if self.sockets.take() > 0.0:
                self.sockets.give_back()
                return connection.respond(HTTPStatus.TOO_MANY_REQUESTS, "Too many new visitors; wait.\n")
        return None

    def below_token(self, request: Request) -> Request:
        """The request as viser knows it, without the token in its path."""
        return replace(request, path="/" + request.path.removeprefix(f"/{self.token}").removeprefix("/"))


@contextmanager
def guard_sockets(gate: Gate) -> Iterator[None]:
    """Let the server that viser starts in the block ask ``gate`` about every request.

    Raises:
        RuntimeError: viser has opened its socket in another way, so nothing would be refused.
    """
    serve, asked = websockets.asyncio.server.serve, []

    def serve_guarded(
        handler: Any, *address: Any, process_request: Callable[..., Response | None], **settings: Any
    ) -> Any:
        asked.append(address)

        def answer(connection: ServerConnection, request: Request) -> Response | None:
            response = gate.refuse(connection, request)
            if response is None:
                response = process_request(connection, gate.below_token(request))
                response = response and add_page_script(response)
            if response is not None:
                for name, value in HEADERS.items():
                    response.headers[name] = value
            return response

        connection = partial(VisitorConnection, lambda: gate.is_behind())
        settings |= {**LIMITS, "process_request": answer, "create_connection": connection}
        return serve(handler, *address, **settings)

    websockets.asyncio.server.serve = serve_guarded  # type: ignore[assignment,misc]
    try:
        yield
    finally:
        websockets.asyncio.server.serve = serve  # type: ignore[misc]
    if not asked:
        raise RuntimeError(
            f"viser {viser.__version__} opens its socket in a way that cannot be guarded; install 1.1.1"
        )


def _first_part(request: Request) -> bytes:
    first = request.path.partition("?")[0].removeprefix("/").partition("/")[0]
    return first.encode(errors="surrogateescape")  # a path may hold bytes that are no text
