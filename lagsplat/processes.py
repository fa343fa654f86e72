"""How processes end: with the one that started them, as jobs of a workflow do, or by a signal.

A Snakemake that is killed leaves its jobs running, and they would write beside those of the next run. So
each Snakemake process, the one on a node of a cluster included, announces itself to what it starts, and a job
asks the kernel to be killed with it. Linux alone can do this; elsewhere a job goes on, and its lease keeps
the next run out (`lagsplat.io.files.lease`).
"""

import contextlib
import ctypes
import os
import queue
import select
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

VARIABLE = "LAGSPLAT_DRIVER"  # number and namespace of the Snakemake process that started a job
SIGNAL_WAIT_S = 0.5  # longest delay of an answer to a signal
PR_SET_PDEATHSIG = 1  # <linux/prctl.h>


def announce_driver() -> None:
    """Let the jobs that this process starts know that they belong to it."""
    os.environ[VARIABLE] = f"{os.getpid()} {_namespace()}"


def end_with_driver() -> None:
    """Let the kernel kill this process when the Snakemake process that started it ends, for whatever reason.

    Nothing happens without `announce_driver`, outside Linux, or in a container with its own process numbers.

    Raises:
        SystemExit: that process has ended already.
    """
    number, _, namespace = os.environ.get(VARIABLE, "").partition(" ")
    if sys.platform != "linux" or not number or namespace != _namespace():
        return
    _end_with_parent(os.getppid())
    # The parent may be a shell that outlives Snakemake, so Snakemake itself is watched, too.
    try:
        driver = os.pidfd_open(int(number))
    except ProcessLookupError:
        sys.exit(f"Snakemake (process {number}), which started this job, has ended; run snakemake again")
    threading.Thread(target=_end_after, args=(driver,), name="driver", daemon=True).start()


def ends_with_this_process() -> dict[str, Any]:
    """Arguments for `subprocess` with which a child is killed when the thread that starts it ends."""
    return {"preexec_fn": partial(_end_with_parent, os.getpid())} if sys.platform == "linux" else {}


def run_reader(program: str, *words: str, timeout_s: float | None = None) -> bytes:
    """Run a program that reads a file, which a damaged one may crash or stop, in a process of its own.

    Args:
        program: text of the Python program. No file of the working directory is taken for a module.
        words: its arguments.
        timeout_s: longest duration [s].

    Returns:
        What it writes.

    Raises:
        ChildProcessError: it fails; ``errno`` is its exit status, ``strerror`` the last line of its errors.
        TimeoutExpired: it takes longer.
    """
    command = [sys.executable, "-P", "-c", program, *words]
    options = {"capture_output": True, "timeout": timeout_s, "check": False, **ends_with_this_process()}
    done: subprocess.CompletedProcess[bytes] = subprocess.run(command, **options)
    if done.returncode:
        told = done.stderr.decode(errors="replace").strip().rpartition("\n")[2]
        raise ChildProcessError(done.returncode, told)
    return done.stdout


@contextlib.contextmanager
def receive_signals() -> Iterator[Callable[[], signal.Signals]]:
    """Queue SIGINT and SIGTERM while the block runs, instead of acting; the main thread alone can.

    Gives a function that waits for the first.
    """
    received: queue.SimpleQueue[signal.Signals] = queue.SimpleQueue()
    numbers = (signal.SIGINT, signal.SIGTERM) if threading.current_thread() is threading.main_thread() else ()
    earlier = {n: signal.signal(n, lambda number, _: received.put(signal.Signals(number))) for n in numbers}

    def wait() -> signal.Signals:
        while True:
            # A signal just before the wait would run its handler only after it, so no wait is endless.
            with contextlib.suppress(queue.Empty):
                return received.get(timeout=SIGNAL_WAIT_S)

    try:
        yield wait
    finally:
        for number, handler in earlier.items():
            signal.signal(number, handler)


def _end_with_parent(parent: int) -> None:
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it ended before the kernel was told
        os.kill(os.getpid(), signal.SIGKILL)


def _end_after(process: int) -> None:
    watched = select.poll()
    watched.register(process, select.POLLIN)
    watched.poll()
    os.kill(os.getpid(), signal.SIGKILL)


def _namespace() -> str:
    place = Path("/proc/self/ns/pid")
    return os.readlink(place) if place.is_symlink() else ""
