"""How many steps of the dynamics are due: model time runs with the wall's, or with a multiple of it.

Two clocks: one thread steps a session in real time, another draws its latest snapshot as fast as it may.

Whoever else wants something of the session leaves a command; commands take effect between two steps.
"""

import logging
import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from lagsplat.viewer.simulation.session import Session, Snapshot

LATEST_S = 0.25
"""Of the wall: what is due for longer is forgotten, so that a pause of the machine is not made up in a
leap."""


class StepClock:
    """Model time in steps of ``dt_s``, ``speed`` times as fast as the wall's clock [s]."""

    def __init__(self, dt_s: float, *, now_s: float) -> None:
        self.dt_s, self.speed = dt_s, 1.0
        self.owed, self.seen_s, self.forgotten = 0.0, now_s, 0

    def due(self, now_s: float, *, running: bool = True) -> int:
        """Whole steps due by now; they count as done. While not ``running`` none falls due."""
        passed, self.seen_s = max(0.0, now_s - self.seen_s), now_s
        if not running:
            return 0
        self.owed += passed * self.speed / self.dt_s
        most = max(1.0, LATEST_S * self.speed / self.dt_s)
        if self.owed > most:
            self.forgotten += int(self.owed - most)
            self.owed = most
        steps = int(self.owed + 1e-9)  # a step is due although sums of times are rounded
        self.owed = max(0.0, self.owed - steps)
        return steps

    def wait_s(self) -> float:
        """How long until the next step falls due."""
        return (1.0 - self.owed) * self.dt_s / self.speed


IDLE_S = 0.25
RATE_S = 1.0
log = logging.getLogger(__name__)
Command = Callable[[Session], Any]


class RealtimeLoop:
    """Runs a session until `stop`.

    ``show`` is called with snapshots in a thread of its own, never with two at once and at most
    ``pictures_hz`` times a second; what happens in between is skipped. ``refuse`` is told why a command was
    refused.
    """

    def __init__(
        self,
        session: Session,
        show: Callable[[Snapshot], None],
        *,
        pictures_hz: float,
        refuse: Callable[[str], None] = log.warning,
    ) -> None:
        self.session, self.show, self.refuse, self.period_s = session, show, refuse, 1.0 / pictures_hz
        self.clock = StepClock(session.dt_s, now_s=time.perf_counter())
        self.commands: queue.SimpleQueue[Command] = queue.SimpleQueue()
        self.over = threading.Event()
        self.fresh, self.latest = threading.Condition(), session.snapshot()
        self.stepped: deque[tuple[float, int]] = deque()
        self.drawn: deque[float] = deque()
        self.threads = [
            threading.Thread(target=self._dynamics, name="dynamics", daemon=True),
            threading.Thread(target=self._pictures, name="pictures", daemon=True),
        ]

    def start(self) -> None:
        """Begin to run."""
        for thread in self.threads:
            thread.start()

    def stop(self) -> None:
        """End both threads, and wait for them."""
        self.over.set()
        self.tell(lambda session: None)
        with self.fresh:
            self.fresh.notify_all()
        for thread in self.threads:
            thread.join(timeout=5.0)

    def tell(self, command: Command) -> None:
        """Have ``command`` called with the session between two steps; from any thread, at once."""
        self.commands.put(command)

    def rates(self) -> tuple[float, float]:
        """Steps and pictures of the last second."""
        now = time.perf_counter()
        steps = sum(count for at, count in list(self.stepped) if at > now - RATE_S)
        return steps / RATE_S, sum(at > now - RATE_S for at in list(self.drawn)) / RATE_S

    def _dynamics(self) -> None:
        while not self.over.is_set():
            running = self.session.status == "running"
            wait_s = self.clock.wait_s() if running else IDLE_S
            changed = self._obey(wait_s)
            now = time.perf_counter()
            due = self.clock.due(now, running=running)
            self._step(due)
            if due:
                self.stepped.append((now, due))
                while self.stepped[0][0] < now - RATE_S:
                    self.stepped.popleft()
            if due or changed:
                with self.fresh:
                    self.latest = self.session.snapshot()
                    self.fresh.notify_all()

    def _step(self, times: int) -> None:
        try:
            for _ in range(times):
                self.session.step()
        except Exception:  # without its thread the page would stand still and say nothing
            log.exception("a step failed; the session stopped")
            self.session.halt()

    def _obey(self, wait_s: float) -> bool:
        """Carry out what was asked for, waiting for a first command; whether there was any."""
        try:
            command = self.commands.get(timeout=max(0.0, wait_s))
        except queue.Empty:
            return False
        while True:
            try:
                command(self.session)
            except ValueError as error:
                self._tell_why(str(error))
            except Exception:  # a command must not end the session of everyone else
                log.exception("a command failed; the session goes on")
                self._tell_why("That failed inside; the session goes on. The server's log says why.")
            try:
                command = self.commands.get_nowait()
            except queue.Empty:
                return True

    def _tell_why(self, refusal: str) -> None:
        try:
            self.refuse(refusal)
        except Exception:  # who asked may have left meanwhile
            log.exception("a refusal could not be told; the session goes on")

    def _pictures(self) -> None:
        shown: Snapshot | None = None
        while not self.over.is_set():
            with self.fresh:
                self.fresh.wait_for(lambda: self.latest is not shown or self.over.is_set(), timeout=IDLE_S)  # noqa: B023
                snapshot = self.latest
            if snapshot is shown or self.over.is_set():
                continue
            began = time.perf_counter()
            try:
                self.show(snapshot)
            except Exception:  # a picture that fails must not end the simulation
                log.exception("a picture failed; the session goes on")
            shown = snapshot
            self.drawn.append(began)
            while self.drawn[0] < began - RATE_S:
                self.drawn.popleft()
            self.over.wait(max(0.0, self.period_s - (time.perf_counter() - began)))
