"""A visitor of a live view for a long time: reads pictures, or does at random what a page lets one do."""

import contextlib
import random
import threading
import time
from collections import Counter, deque
from dataclasses import dataclass
from itertools import pairwise
from statistics import median
from typing import Any

import msgspec
import viser
import zstandard
from websockets.exceptions import ConnectionClosed, InvalidHandshake
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Subprotocol

from tests.unit.viewer.visitors import camera, dragged, send

PICTURE = "/picture"
BANNER = "> **"
PROTOCOL = Subprotocol(f"viser-v{viser.__version__}")
LEFT_OUT = ("Speed", "Dark")  # another number of steps a picture costs another time
LOST = (ConnectionClosed, InvalidHandshake, OSError)
RETRY_S = 0.5


def decode(data: bytes) -> list[dict[str, Any]]:
    """The messages of a window: its size, its compressed size, and these, before raw arrays."""
    size = int.from_bytes(data[8:16], "little")
    return msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(data[16 : 16 + size]))["messages"]


@dataclass(frozen=True)
class Times:
    """Times between two pictures or lines of the state, and of answers to pings [s]."""

    gaps_s: tuple[float, ...]
    pings_s: tuple[float, ...]

    def __str__(self) -> str:
        parts = ((self.gaps_s, "gaps"), (self.pings_s, "pings"))
        return ", ".join(
            f"{len(times)} {name}, median {1e3 * median(times):.0f} ms, longest {1e3 * max(times):.0f} ms"
            for times, name in parts
            if times
        )


class Visitor:
    """One visitor, who may come again. ``pictures`` and ``model_s`` are what was seen so far.

    A picture of an object at rest is not sent again; the line with time and rates comes all the time.
    """

    def __init__(self, url: str) -> None:
        self.url = url.replace("http", "ws")
        self.client: ClientConnection | None = None
        self.visits = self.pictures = 0
        self.model_s, self.stopped = 0.0, False
        self.seen_s: deque[float] = deque(maxlen=10_000)
        self.pings_s: deque[float] = deque(maxlen=10_000)
        self.controls: dict[str, tuple[str, str, dict[str, Any]]] = {}
        self.acts: Counter[str] = Counter()

    def come(self) -> ClientConnection:
        """Connect, if that is not so; as a page, tell the camera."""
        if self.client is None:
            client = connect(
                self.url, subprotocols=[PROTOCOL], open_timeout=60, ping_interval=None, max_size=None
            )
            send(client, camera())
            self.client, self.visits = client, self.visits + 1
            self.controls.clear()
        return self.client

    def leave(self, *, politely: bool = True) -> None:
        """Close the socket, or cut it."""
        if self.client is not None:
            if politely:
                self.client.close()
            else:
                self.client.socket.close()
            self.client = None

    def read(self, seconds: float) -> None:
        """Read what comes for some time."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            try:
                data = self.come().recv(timeout=left)
            except TimeoutError:
                return
            for message in decode(data):
                self.take(message)

    def take(self, message: dict[str, Any]) -> None:
        """Keep what a message tells of pictures, time and controls."""
        kind, updates = message["type"], message.get("updates") or {}
        if kind == "SceneNodeUpdateMessage" and message["name"] == PICTURE and "_data" in updates:
            self.pictures += 1
            self.seen_s.append(time.monotonic())
        elif (text := updates.get("_markdown")) is not None:
            if " steps/s" in text:
                self.seen_s.append(time.monotonic())
                self.model_s = float(text.removeprefix("<sub>").partition(" s ")[0])
            elif not text or text.startswith(BANNER):
                self.stopped = "Reset to rest" in text
        elif "uuid" in message and (label := (message.get("props") or {}).get("label")):
            self.controls[label] = (kind, message["uuid"], message["props"])

    def ping(self) -> None:
        """Keep how long the last pong took, and ask for another; from any thread."""
        client = self.client
        with contextlib.suppress(*LOST):
            if client is not None:
                self.pings_s.extend([client.latency] if client.latency else [])
                client.ping()

    def forget_times(self) -> Times:
        """Times since the last call."""
        seen, self.seen_s = list(self.seen_s), deque(maxlen=self.seen_s.maxlen)
        pings, self.pings_s = tuple(self.pings_s), deque(maxlen=self.pings_s.maxlen)
        return Times(tuple(b - a for a, b in pairwise(seen)), pings)

    def keep_reading(self, stopping: threading.Event) -> None:
        """Read until told to stop; reset a motion that diverged, come again when dropped."""
        while not stopping.is_set():
            try:
                self.read(1.0)
                if self.stopped and "Time" in self.controls:
                    self.press_time("Rest")
            except LOST:
                self.client = None
                stopping.wait(RETRY_S)
        self.leave()

    def set(self, label: str, value: Any) -> None:
        """Set the value of a control."""
        _, uuid, _ = self.controls[label]
        send(self.come(), {"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}})

    def press_time(self, name: str) -> None:
        """Press one of the buttons Pause, Run, Step and Rest."""
        self.set("Time", name)

    def drag(self, chance: random.Random) -> None:
        """Drag from somewhere in the picture, for a while."""
        start = [chance.uniform(-1.0, 1.0), chance.uniform(-1.0, 1.0), 0.0]
        at = list(start)
        send(self.come(), dragged("start", start, at))
        for _ in range(chance.randrange(2, 40)):
            at = [x + chance.gauss(0.0, 0.1) for x in at[:2]] + [0.0]
            send(self.come(), dragged("update", start, at))
            self.read(0.05)
        send(self.come(), dragged("end", start, at))

    def press_key(self, chance: random.Random) -> None:
        """Press an arrow key some times."""
        uuid = self.controls[chance.choice(["Push left", "Push right", "Push up", "Push down"])][1]
        for _ in range(chance.randrange(1, 5)):
            send(self.come(), {"type": "CommandTriggerMessage", "uuid": uuid})
            self.read(0.2)

    def pause(self, chance: random.Random) -> None:
        """Pause, step, and go on."""
        self.press_time("Pause")
        for _ in range(chance.randrange(4)):
            self.read(0.2)
            self.press_time("Step")
        self.read(chance.uniform(0.0, 1.0))
        self.press_time("Run")

    def reset(self, chance: random.Random) -> None:
        """Reset to rest, or to a recorded frame."""
        if chance.random() < 0.5:
            self.press_time("Rest")
        else:
            self.set("Frame", chance.randrange(int(self.controls["Frame"][2]["max"])))

    def slide(self, chance: random.Random) -> None:
        """Move a slider: an input, an edit of the law, the brush; all edits are undone in the end."""
        sliders = [label for label, (kind, _, _) in self.controls.items() if kind == "GuiSliderMessage"]
        label = chance.choice([label for label in sliders if label not in LEFT_OUT])
        bounds = self.controls[label][2]
        for _ in range(chance.randrange(1, 6)):
            self.set(label, chance.uniform(bounds["min"], bounds["max"]))
            self.read(0.1)
        self.set("As learned", True)

    def look(self, chance: random.Random) -> None:
        """Switch something on and off that is shown or followed."""
        boxes = [label for label, (kind, _, _) in self.controls.items() if kind == "GuiCheckboxMessage"]
        label = chance.choice([label for label in boxes if label not in LEFT_OUT])
        for on in (True, False):
            self.set(label, on)
            self.read(chance.uniform(0.2, 1.0))

    def come_again(self, chance: random.Random) -> None:
        """Leave, politely or not, and come back."""
        self.leave(politely=chance.random() < 0.5)
        time.sleep(chance.uniform(0.0, 1.0))
        self.read(1.0)

    def replay(self, chance: random.Random) -> None:
        """Replay what was done, until the next push."""
        self.set("Replay what I did", True)
        self.read(chance.uniform(0.5, 2.0))
        self.press_time("Rest")

    def wait(self, chance: random.Random) -> None:
        """Watch."""
        self.read(chance.uniform(0.5, 4.0))


ACTS = (
    *(Visitor.drag, Visitor.drag, Visitor.drag, Visitor.press_key, Visitor.pause, Visitor.reset),
    *(Visitor.slide, Visitor.look, Visitor.come_again, Visitor.replay, Visitor.wait),
)


def act_at_random(visitor: Visitor, chance: random.Random, stopping: threading.Event) -> None:
    """Do one thing after another until told to stop; come again when dropped."""
    while not stopping.is_set():
        try:
            while "Replay what I did" not in visitor.controls:
                visitor.read(1.0)
            act = chance.choice(ACTS)
            act(visitor, chance)
            visitor.acts[act.__name__] += 1
        except LOST:
            visitor.client = None
            visitor.acts["lost"] += 1
            stopping.wait(RETRY_S)
    visitor.leave()
