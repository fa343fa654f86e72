"""Jobs end with the Snakemake that started them: alone, behind a shell, or before they could ask."""

import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from lagsplat.processes import VARIABLE, announce_driver, end_with_driver, ends_with_this_process

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux ends a process with its parent")

PATIENCE_S = 30.0
DRIVER = """
import subprocess, sys
from lagsplat.processes import announce_driver
announce_driver()
subprocess.run(sys.argv[1:])
"""
JOB = """
import os, sys, time
from lagsplat.processes import end_with_driver
end_with_driver()
print(os.getpid(), flush=True)
"""
SLEEP, COMPUTE = "time.sleep(600)", "sum(range(10**12))"  # the latter never lets another thread run
TOOL = """
import subprocess, sys
from lagsplat.processes import ends_with_this_process
inner = "import os, time; print(os.getpid(), flush=True); time.sleep(600)"
subprocess.run([sys.executable, "-c", inner], **ends_with_this_process())
"""


@contextmanager
def running(program: str, *words: str) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """A program, and a handle of the process below it that has told its number."""
    command = [sys.executable, "-c", program, *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        number = int(process.stdout.readline())
        below = os.pidfd_open(number)
        try:
            yield process, below
        finally:
            process.kill()
            if not has_ended(below, 0.0):
                os.kill(number, signal.SIGKILL)
            os.close(below)


def has_ended(handle: int, patience_s: float = PATIENCE_S) -> bool:
    watched = select.poll()
    watched.register(handle, select.POLLIN)
    return bool(watched.poll(1000 * patience_s))


@pytest.mark.parametrize(
    "words",
    [
        (sys.executable, "-c", JOB + SLEEP),
        (sys.executable, "-c", JOB + COMPUTE),
        ("bash", "-c", '"$@"; echo after', "bash", sys.executable, "-c", JOB + SLEEP),
    ],
    ids=["asleep", "in compiled code", "behind a shell"],
)
def test_a_job_ends_with_a_killed_driver(words: tuple[str, ...]) -> None:
    with running(DRIVER, *words) as (driver, job):
        assert not has_ended(job, 0.3)
        driver.kill()
        assert has_ended(job)


def test_a_tool_ends_with_a_killed_job() -> None:
    with running(TOOL) as (job, tool):
        assert not has_ended(tool, 0.3)
        job.kill()
        assert has_ended(tool)


def test_a_job_whose_driver_has_ended_already_does_not_start(monkeypatch: pytest.MonkeyPatch) -> None:
    with subprocess.Popen([sys.executable, "-c", "pass"]) as gone:
        gone.wait()
    announce_driver()
    own = os.environ.pop(VARIABLE)
    monkeypatch.setenv(VARIABLE, own.replace(str(os.getpid()), str(gone.pid), 1))
    done = subprocess.run([sys.executable, "-c", JOB], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert f"Snakemake (process {gone.pid}), which started this job, has ended" in done.stderr
    assert done.stdout == ""


def test_what_no_driver_started_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(VARIABLE, raising=False)
    end_with_driver()
    monkeypatch.setenv(VARIABLE, "1 pid:[0]")  # of another container
    end_with_driver()
    assert subprocess.run(["true"], **ends_with_this_process(), check=False).returncode == 0
