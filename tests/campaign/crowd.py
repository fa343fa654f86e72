"""A crowd at a live view: hundreds of sockets at once, most of which no page would open like that.

`run_crowd` opens them from one process. Every kind tries again, when it is turned away or dropped, until the
time is over. What the server answers and how long it holds a socket is counted by kind.
"""

import asyncio
import random
import socket
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from urllib.parse import urlsplit

import msgspec
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus

from tests.unit.viewer.visitors import PROTOCOL, camera, dragged

UPGRADE = (
    "GET {path} HTTP/1.1\r\nHost: {host}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n"
    "Sec-WebSocket-Protocol: {protocol}\r\n{more}\r\n"
)
PAUSE_S = 1.0  # mean pause before one tries again
SLOW_BYTES, SLOW_S = 100, 0.1
LONGEST_VISIT_S = 8.0  # of one who is let in, so that others come in, too
TIMEOUT_S = 60.0  # of a connection


@dataclass
class Crowd:
    """What a crowd knows, and what happened to it, by kind."""

    path: str
    host: str
    end_s: float
    chance: random.Random
    answers: Counter[tuple[str, str]] = field(default_factory=Counter)
    longest_s: dict[str, float] = field(default_factory=dict)
    inside: int = 0
    most_inside: int = 0

    @property
    def left_s(self) -> float:
        return max(0.0, self.end_s - asyncio.get_running_loop().time())

    def count(self, kind: str, answer: str) -> None:
        self.answers[kind, answer] += 1

    @asynccontextmanager
    async def admitted(self) -> AsyncIterator[None]:
        """Count who is inside while the block runs."""
        self.inside += 1
        self.most_inside = max(self.most_inside, self.inside)
        try:
            yield
        finally:
            self.inside -= 1


@dataclass(frozen=True)
class Raw:
    """A socket without a library: it answers no ping, and reads as slowly as it likes."""

    socket: socket.socket
    loop: asyncio.AbstractEventLoop

    async def send(self, data: bytes) -> None:
        await self.loop.sock_sendall(self.socket, data)

    async def read(self, size: int = 65536) -> bytes:
        return await self.loop.sock_recv(self.socket, size)

    async def read_all(self, size: int = 65536, every_s: float = 0.0) -> None:
        """Read until the server closes."""
        with suppress(ConnectionError):
            while await self.read(size):
                await asyncio.sleep(every_s)


@asynccontextmanager
async def dial(crowd: Crowd) -> AsyncIterator[Raw]:
    """A new socket, its buffer small."""
    loop = asyncio.get_running_loop()
    with socket.socket() as one:
        one.setblocking(False)
        one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        name, _, port = crowd.host.partition(":")
        await loop.sock_connect(one, (name, int(port)))
        yield Raw(one, loop)


async def ask(crowd: Crowd, raw: Raw, kind: str, path: str, more: str = "") -> bool:
    """Ask to be let in; counts the answer, tells whether it is yes."""
    await raw.send(UPGRADE.format(path=path, host=crowd.host, protocol=PROTOCOL, more=more).encode())
    answer = await raw.read(4096)
    crowd.count(kind, answer[9:12].decode(errors="replace") or "closed")
    return answer[9:12] == b"101"


async def hold(crowd: Crowd, kind: str, wait: Awaitable[None]) -> None:
    """Wait until the server closes, and keep the longest time."""
    loop = asyncio.get_running_loop()
    began = loop.time()
    await wait
    crowd.longest_s[kind] = max(crowd.longest_s.get(kind, 0.0), loop.time() - began)


async def visit(crowd: Crowd, kind: str, *, flood: bool) -> None:
    """Come in for some seconds by the library, which answers pings; read, or send drags without a pause."""
    url, settings = f"ws://{crowd.host}{crowd.path}", {"open_timeout": TIMEOUT_S, "ping_interval": None}
    try:
        async with connect(url, subprotocols=[PROTOCOL], **settings) as client, crowd.admitted():
            crowd.count(kind, "101")
            await client.send(msgspec.msgpack.encode(camera()))
            sender = asyncio.create_task(send_drags(crowd, client.send)) if flood else None
            try:
                with suppress(TimeoutError):
                    async with asyncio.timeout(crowd.chance.uniform(1.0, LONGEST_VISIT_S)):
                        async for _ in client:
                            pass
            finally:
                if sender is not None:
                    sender.cancel()
    except InvalidStatus as error:
        crowd.count(kind, str(error.response.status_code))


async def send_drags(crowd: Crowd, send: Callable[[bytes], Awaitable[None]]) -> None:
    """Send drags without a pause."""
    with suppress(ConnectionClosed):
        while True:
            for phase in ("start", *["update"] * 20, "end"):
                to = (crowd.chance.uniform(-0.05, 0.05), 0.0, 0.0)
                await send(msgspec.msgpack.encode(dragged(phase, (0.0, 0.0, 0.0), to)))
                await asyncio.sleep(0.0)


async def open_valid(crowd: Crowd) -> None:
    await visit(crowd, "valid", flood=False)


async def flood_drags(crowd: Crowd) -> None:
    await visit(crowd, "flood", flood=True)


async def guess_token(crowd: Crowd) -> None:
    async with dial(crowd) as raw:
        await ask(crowd, raw, "wrong token", f"/{crowd.chance.randbytes(18).hex()}/")


async def come_from_elsewhere(crowd: Crowd) -> None:
    async with dial(crowd) as raw:
        await ask(crowd, raw, "wrong origin", crowd.path, "Origin: http://evil.example\r\n")


async def be_silent(crowd: Crowd) -> None:
    """Read all that comes, and answer nothing, not even a ping."""
    async with dial(crowd) as raw:
        if await ask(crowd, raw, "silent", crowd.path):
            async with crowd.admitted():
                await hold(crowd, "silent", raw.read_all())


async def read_slowly(crowd: Crowd) -> None:
    async with dial(crowd) as raw:
        if await ask(crowd, raw, "slow", crowd.path):
            await raw.read_all(SLOW_BYTES, SLOW_S)


async def send_half(crowd: Crowd) -> None:
    """Send a part of a request that would be let in."""
    async with dial(crowd) as raw:
        whole = UPGRADE.format(path=crowd.path, host=crowd.host, protocol=PROTOCOL, more="").encode()
        await raw.send(whole[: crowd.chance.randrange(len(whole) - 2)])
        crowd.count("half", "sent")
        await hold(crowd, "half", raw.read_all())


async def send_garbage(crowd: Crowd) -> None:
    async with dial(crowd) as raw:
        await raw.send(crowd.chance.randbytes(crowd.chance.randrange(1, 8192)))
        crowd.count("garbage", "sent")
        await hold(crowd, "garbage", raw.read_all())


KINDS = (
    *(open_valid, guess_token, come_from_elsewhere, be_silent),
    *(read_slowly, send_half, send_garbage, flood_drags),
)


async def keep_trying(crowd: Crowd, act: Callable[[Crowd], Awaitable[None]]) -> None:
    """Act until the time is over."""
    while crowd.left_s > 0.0:
        try:
            async with asyncio.timeout(crowd.left_s):
                await act(crowd)
        except TimeoutError:
            return
        except (OSError, InvalidHandshake, ConnectionClosed) as error:
            crowd.count(act.__name__, type(error).__name__)
        await asyncio.sleep(crowd.chance.uniform(0.0, 2.0 * PAUSE_S))


def run_crowd(url: str, count: int, seconds: float, seed: int) -> Crowd:
    """Open ``count`` sockets at once, of all kinds in turn, and keep trying for some time."""

    async def run() -> Crowd:
        parts, loop = urlsplit(url), asyncio.get_running_loop()
        crowd = Crowd(parts.path, parts.netloc, loop.time() + seconds, random.Random(seed))
        await asyncio.gather(*(keep_trying(crowd, KINDS[i % len(KINDS)]) for i in range(count)))
        return crowd

    return asyncio.run(run())
