"""The lease of a run: refused while its holder lives, taken over when it does not, whatever the date says."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from lagsplat.io.files.lease import hold_lease, locate_lease

DURATION_S = 1.5
HOLD = """
import sys, time
from lagsplat.io.files.lease import hold_lease
with hold_lease(sys.argv[1], duration_s=float(sys.argv[2])):
    print("held", flush=True)
    time.sleep(600)
"""
ELSEWHERE = "filelock/2\npid=1\nhost=another-machine\nmode=lease\ntoken={}\nduration=1.5\nstart=7\n"
DATES = [0.0, time.time() + 10 * 365 * 86400.0]
"""Before and long after now, as on a machine whose clock was set while the lease was held [s]."""


@contextmanager
def holder(target: Path) -> Iterator[subprocess.Popen[str]]:
    """Another process that holds the lease."""
    command = [sys.executable, "-c", HOLD, str(target), str(DURATION_S)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "held\n"
            yield process
        finally:
            process.kill()


def test_a_lease_lies_beside_what_is_made_and_goes_with_the_block(tmp_path: Path) -> None:
    target = tmp_path / "run" / "autoencoder.safetensors"
    with hold_lease(target) as path:
        assert path == locate_lease(target)
        assert path.parent == target.parent
        assert path.is_file()
    assert list(target.parent.iterdir()) == []


def test_who_waits_gets_the_lease_when_the_holder_has_ended(tmp_path: Path) -> None:
    target, waits = tmp_path / "model", []
    with holder(target) as process:

        def end() -> None:
            waits.append(process.pid)
            process.kill()

        with hold_lease(target, duration_s=DURATION_S, on_wait=end) as path:
            assert path.is_file()
    assert len(waits) == 1


@pytest.mark.parametrize("date", [None, *DATES], ids=["now", "1970", "in ten years"])
def test_a_second_writer_is_refused_whatever_the_date(tmp_path: Path, date: float | None) -> None:
    target = tmp_path / "model"
    with holder(target) as process:
        if date is not None:
            os.utime(locate_lease(target), (date, date))
        with (
            pytest.raises(BlockingIOError, match=rf"process {process.pid} on \S+ is making it.*delete"),
            hold_lease(target, duration_s=DURATION_S),
        ):
            pytest.fail("two writers")


@pytest.mark.parametrize("date", [None, *DATES], ids=["now", "1970", "in ten years"])
def test_the_lease_of_a_killed_process_is_taken_over_at_once(tmp_path: Path, date: float | None) -> None:
    target = tmp_path / "model"
    with holder(target) as process:
        process.send_signal(signal.SIGKILL)
        process.wait()
        if date is not None:
            os.utime(locate_lease(target), (date, date))
        began = time.monotonic()
        with hold_lease(target):
            assert time.monotonic() - began < 5.0, "no need to wait: the process is known to be gone"


@pytest.mark.parametrize("date", DATES, ids=["1970", "in ten years"])
def test_a_lease_of_another_machine_is_taken_over_once_it_stands_still(tmp_path: Path, date: float) -> None:
    target = tmp_path / "model"
    locate_lease(target).write_text(ELSEWHERE.format("a" * 32))
    os.utime(locate_lease(target), (date, date))
    began = time.monotonic()
    with hold_lease(target, duration_s=DURATION_S):
        assert time.monotonic() - began >= DURATION_S


def test_a_lease_of_another_machine_that_is_touched_is_refused(tmp_path: Path) -> None:
    path = locate_lease(tmp_path / "model")
    path.write_text(ELSEWHERE.format("a" * 32))
    done = threading.Event()

    def beat() -> None:
        date = 1e6
        while not done.wait(DURATION_S / 4):
            date -= 1000.0  # a clock that runs backwards
            os.utime(path, (date, date))

    thread = threading.Thread(target=beat)
    thread.start()
    try:
        with (
            pytest.raises(BlockingIOError, match="process 1 on another-machine is making it"),
            hold_lease(tmp_path / "model", duration_s=DURATION_S),
        ):
            pytest.fail("two writers")
    finally:
        done.set()
        thread.join()


def test_a_process_that_lost_its_lease_ends(tmp_path: Path) -> None:
    target = tmp_path / "model"
    with holder(target) as process:
        locate_lease(target).unlink()
        locate_lease(target).write_text(ELSEWHERE.format("b" * 32))
        assert process.wait(60.0) == -signal.SIGTERM
        assert process.stderr is not None
        assert "the lease was lost (owner-changed); this process ends" in process.stderr.read()


def test_a_lease_lost_at_the_end_is_an_error(tmp_path: Path) -> None:
    target = tmp_path / "model"
    held = hold_lease(target)
    path = held.__enter__()
    path.unlink()
    path.write_text(ELSEWHERE.format("b" * 32))
    with pytest.raises(BlockingIOError, match="another process has taken over"):
        held.__exit__(None, None, None)
    assert "another-machine" in path.read_text(), "the lease of the other one stays"
