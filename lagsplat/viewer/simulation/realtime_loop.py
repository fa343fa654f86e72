"""The real-time loop: one thread steps a session in time with the clock, another draws its latest snapshot.

Everything else reaches the session as a command, which is executed between two steps.
"""

import contextlib
import logging
import queue
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

from lagsplat.viewer.simulation.session import Session, Snapshot

LATEST_S = 0.25
"""Longest backlog [s] of wall-clock time: older steps are dropped, so that the model does not leap after a
pause of the machine."""


class StepClock:
    """Counts the due steps of ``dt_s`` while model time runs ``speed`` times as fast as the clock."""

    def __init__(self, dt_s: float, *, now_s: float) -> None:
        self.dt_s, self.speed = dt_s, 1.0
        self.backlog, self.last_s, self.dropped_steps = 0.0, now_s, 0

    def steps_due(self, now_s: float, *, running: bool = True) -> int:
        """Whole steps due at ``now_s``, counted as done from then on; none while not ``running``."""
        passed, self.last_s = max(0.0, now_s - self.last_s), now_s
        if not running:
            return 0
        self.backlog += passed * self.speed / self.dt_s
        most = max(1.0, LATEST_S * self.speed / self.dt_s)
        if self.backlog > most:
            self.dropped_steps += int(self.backlog - most)
            self.backlog = most
        steps = int(self.backlog + 1e-9)  # tolerates the rounding of summed times
        self.backlog = max(0.0, self.backlog - steps)
        return steps

    def wait_s(self) -> float:
        """Time until the next step is due [s]."""
        return (1.0 - self.backlog) * self.dt_s / self.speed


IDLE_S = 0.25  # longest wait for a command or a snapshot [s]
RATE_S = 1.0  # window over which the rates are counted [s]
LOGGED = 4096  # latest counts that are kept, more than come within that window
MOST_WAITING = 32  # commands; whoever sends more has to wait
log = logging.getLogger(__name__)
Command = Callable[[Session], Any]


class RealtimeLoop:
    """Runs a session in two threads from `start` until `stop`; no other thread may call it meanwhile.

    ``draw`` is called with snapshots in a thread of its own, at most ``viewer.pictures_hz`` times a second;
    those that come faster are skipped. ``report_error`` is called with the reason why a command was refused.
    """

    def __init__(
        self, session: Session, draw: Callable[[Snapshot], None], report_error: Callable[[str], None]
    ) -> None:
        self.session, self.draw, self.report_error = session, draw, report_error
        self.period_s = 1.0 / session.config.pictures_hz
        self.clock = StepClock(session.dt_s, now_s=time.perf_counter())
        self.commands: queue.SimpleQueue[Command] = queue.SimpleQueue()
        self.stopping = threading.Event()
        self.updated, self.latest = threading.Condition(), session.snapshot()
        self.step_log: deque[tuple[float, int]] = deque(maxlen=LOGGED)
        self.frame_log: deque[tuple[float, int]] = deque(maxlen=LOGGED)
        bodies = {"dynamics": self._run_dynamics, "drawing": self._run_drawing}
        self.threads = [threading.Thread(target=run, name=name, daemon=True) for name, run in bodies.items()]

    def start(self) -> None:
        """Start both threads."""
        for thread in self.threads:
            thread.start()

    def stop(self) -> None:
        """Stop both threads and wait for them."""
        self.stopping.set()
        self.submit(lambda session: None)
        with self.updated:
            self.updated.notify_all()
        for thread in self.threads:
            thread.join(timeout=5.0)

    def submit(self, command: Command) -> None:
        """Queue ``command``, which is called with the session between two steps; from any thread."""
        self.commands.put(command)

    def is_behind(self) -> bool:
        """Whether so many commands wait that no more should be submitted now."""
        return self.commands.qsize() >= MOST_WAITING

    def rates(self) -> tuple[float, float]:
        """Steps and frames of the last second."""
        since = time.perf_counter() - RATE_S
        steps = sum(count for at, count in list(self.step_log) if at > since)
        frames = sum(count for at, count in list(self.frame_log) if at > since)
        return steps / RATE_S, frames / RATE_S

    def _run_dynamics(self) -> None:
        while not self.stopping.is_set():
            running = self.session.status == "running"
            wait_s = self.clock.wait_s() if running else IDLE_S
            changed = self._run_commands(wait_s)
            running = running and self.session.status == "running"  # unless a command paused it
            now = time.perf_counter()
            due = self.clock.steps_due(now, running=running)
            self._step(due)
            if due:
                self.step_log.append((now, due))
            if due or changed:
                with self.updated:
                    self.latest = self.session.snapshot()
                    self.updated.notify_all()

    def _step(self, times: int) -> None:
        try:
            for _ in range(times):
                self.session.step()
        except Exception:  # else the thread would end and the page freeze without a message
            log.exception("a step failed; the session stopped")
            self.session.stop()

    def _run_commands(self, wait_s: float) -> bool:
        """Execute queued commands after waiting for a first one; return whether there was any.

        They get the time of a picture and the rest of their turn later, or a flood of them would stop the
        steps and the pictures.
        """
        timeout, end_s = max(0.0, wait_s), None
        with contextlib.suppress(queue.Empty):
            while end_s is None or time.perf_counter() < end_s:
                command = self.commands.get(timeout=timeout)
                timeout, end_s = 0.0, end_s or time.perf_counter() + self.period_s
                self._run_command(command)
        return end_s is not None

    def _run_command(self, command: Command) -> None:
        try:
            command(self.session)
            return
        except ValueError as error:
            refusal = str(error)
        except Exception:  # a command of one visitor must not end the session of the others
            log.exception("a command failed; the session goes on")
            refusal = "That failed inside; the session goes on. The server's log says why."
        try:
            self.report_error(refusal)
        except Exception:  # the visitor may have left
            log.exception("a refusal could not be reported; the session goes on")

    def _run_drawing(self) -> None:
        drawn_snapshot: Snapshot | None = None
        while not self.stopping.is_set():
            with self.updated:
                if self.latest is drawn_snapshot and not self.stopping.is_set():
                    self.updated.wait(IDLE_S)
                snapshot = self.latest
            if snapshot is drawn_snapshot or self.stopping.is_set():
                continue
            began = time.perf_counter()
            try:
                self.draw(snapshot)
            except Exception:  # a frame that fails must not end the simulation
                log.exception("a frame failed; the session goes on")
            drawn_snapshot = snapshot
            self.frame_log.append((began, 1))
            self.stopping.wait(max(0.0, self.period_s - (time.perf_counter() - began)))
