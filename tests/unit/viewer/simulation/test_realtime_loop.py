"""The real-time loop: steps keep time, frames are skipped, commands cannot end a session."""

import threading
import time

import pytest

from lagsplat.viewer.simulation.grasp import EnergyBalance
from lagsplat.viewer.simulation.realtime_loop import RealtimeLoop, StepClock
from tests.unit.viewer.sessions import session


def test_steps_are_due_with_the_clock_and_a_long_backlog_is_dropped():
    clock = StepClock(0.02, now_s=0.0)
    assert clock.steps_due(0.1) == 5
    assert [clock.steps_due(0.11), clock.steps_due(0.12)] == [0, 1]
    clock.speed = 2.0
    assert clock.steps_due(0.2) == 8
    assert clock.steps_due(9.0) == 25
    assert clock.dropped_steps > 800
    assert clock.steps_due(10.0, running=False) == 0
    assert clock.steps_due(10.1) <= 10


def test_steps_keep_real_time_while_frames_are_skipped():
    shown, refused = [], []

    def show(snapshot):
        shown.append(snapshot)
        time.sleep(0.05)

    one = session()
    loop = RealtimeLoop(one, show, refused.append)
    loop.start()
    began, first = time.perf_counter(), one.steps
    time.sleep(1.0)
    steps, took = one.steps - first, time.perf_counter() - began
    assert steps * one.dt_s == pytest.approx(took, rel=0.2)
    loop.stop()
    assert len(shown) < 25
    times = [snapshot.time_s for snapshot in shown]
    assert times == sorted(times)
    assert not any(thread.is_alive() for thread in loop.threads)


def test_a_command_that_fails_is_reported_and_the_session_goes_on():
    refused, heard = [], threading.Event()
    one = session()
    loop = RealtimeLoop(one, lambda snapshot: None, refused.append)
    loop.start()
    loop.submit(lambda s: s.grasp((-5.0, 0.0)))
    loop.submit(lambda s: 1 / 0)
    loop.submit(lambda s: heard.set())
    assert heard.wait(5.0)
    assert "outside the image" in refused[0]
    assert "failed inside" in refused[1]
    steps = one.steps
    time.sleep(0.3)
    assert one.steps > steps
    loop.stop()


def test_a_report_that_cannot_be_delivered_ends_nothing():
    def gone(refusal: str) -> None:
        raise UserWarning("queued on a closed connection")

    one, heard = session(), threading.Event()
    loop = RealtimeLoop(one, lambda snapshot: None, gone)
    loop.start()
    loop.submit(lambda s: s.grasp((-5.0, 0.0)))
    loop.submit(lambda s: heard.set())
    assert heard.wait(5.0)
    assert loop.threads[0].is_alive()
    loop.stop()


def test_a_step_that_fails_stops_the_session_until_it_is_reset(monkeypatch):
    one = session()
    loop = RealtimeLoop(one, lambda snapshot: None, print)
    monkeypatch.setattr(EnergyBalance, "after_step", lambda *booked, **more: 1 / 0)
    loop.start()
    end = time.monotonic() + 5.0
    while one.status != "stopped" and time.monotonic() < end:
        time.sleep(0.01)
    assert "stopped" in one.snapshot().banner
    monkeypatch.undo()
    heard = threading.Event()
    loop.submit(lambda s: (s.to_rest(), heard.set()))
    assert heard.wait(5.0)
    time.sleep(0.3)
    assert one.status == "running"
    assert one.steps > 1
    loop.stop()


def test_a_paused_session_still_executes_commands():
    one = session()
    loop = RealtimeLoop(one, lambda snapshot: None, print)
    loop.start()
    loop.submit(lambda s: s.pause(True))
    time.sleep(0.2)
    steps = one.steps
    done = threading.Event()
    loop.submit(lambda s: (s.step(), done.set()))
    assert done.wait(2.0)
    time.sleep(0.2)
    assert one.steps == steps + 1
    loop.stop()


def test_a_pause_takes_back_the_steps_that_are_due():
    one, paused_at = session(), []
    loop = RealtimeLoop(one, lambda snapshot: None, paused_at.append)
    loop.start()
    loop.submit(lambda s: (time.sleep(0.3), s.pause(True), paused_at.append(s.steps)))
    time.sleep(1.0)
    loop.stop()
    assert paused_at == [one.steps]


def test_a_flood_of_commands_stops_neither_steps_nor_pictures_and_is_told():
    shown: list[object] = []
    one = session()
    loop = RealtimeLoop(one, shown.append, lambda text: None)
    assert not loop.is_behind()
    for _ in range(4000):
        loop.submit(lambda s: time.sleep(2e-3))
    assert loop.is_behind()
    loop.start()
    end = time.monotonic() + 20.0
    while (one.steps < 5 or len(shown) < 5) and time.monotonic() < end:
        time.sleep(0.01)
    waiting = loop.commands.qsize()
    loop.stop()
    assert one.steps >= 5
    assert len(shown) >= 5
    assert waiting > 1000, "steps and pictures came in between, not after the last command"
