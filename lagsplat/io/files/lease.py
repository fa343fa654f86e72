"""One writer at a time: a lease beside the files that a process is making.

A lease is a hidden file that names its holder: machine, process, start of the process, boot of the machine.
The holder touches it now and then. On the same machine another process takes it over as soon as the holder
is gone. From another machine the holder cannot be asked: there the lease is taken over once it has stood
still for `DURATION_S`, by the clock that counts since boot and never by the date, so a date that jumps
changes nothing.
"""

import logging
import os
import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import LeaseCompromise, SoftFileLease, Timeout

from lagsplat.io.files.atomic import StrPath

DURATION_S = 30.0
"""How long a lease stands still before another machine takes it over [s]; the same everywhere."""
POLL_S = 0.2  # between two looks at a lease that is waited for
log = logging.getLogger(__name__)


@contextmanager
def hold_lease(
    target: StrPath, *, duration_s: float = DURATION_S, on_wait: Callable[[], None] | None = None
) -> Iterator[Path]:
    """Hold the lease of ``target``, a file or the folder of a run that this process makes, in the block.

    While a process of another machine holds it, this one waits for up to one and a half durations. A process
    that loses its lease, because it was cut off from the disk for so long, ends with SIGTERM.

    Args:
        target: What is made. The lease lies in the same folder, which is created, and not in ``target``.
        duration_s: As `DURATION_S`; every process that makes this target must give the same.
        on_wait: Called before this process waits until the other has ended; without it, it does not wait.

    Yields:
        The file of the lease.

    Raises:
        BlockingIOError: another process makes ``target``, which the message names, and there is no
            ``on_wait``. Or the lease was lost.
        OSError: the folder cannot be written.
    """
    path = locate_lease(target)
    path.parent.mkdir(parents=True, exist_ok=True)
    lease = SoftFileLease(path, lease_duration=duration_s, on_compromise=_end_process, thread_local=False)
    try:
        # The lease of a process that has ended here is taken over first, so what is left after that lives.
        lease.acquire(timeout=1.5 * duration_s, cancel_check=lambda: _is_held_here(lease))
    except Timeout:
        if on_wait is None:
            raise _refusal(target, path, lease) from None
        on_wait()
        lease.acquire(poll_interval=POLL_S)
    try:
        yield path
    finally:
        lease.release()
    if lease.compromise is not None:
        raise BlockingIOError(
            f"{target}: another process has taken over {path} in the meantime ({lease.compromise.reason}), "
            "because this one stood still; what was made here may be mixed with its results: run again"
        )


def _refusal(target: StrPath, path: Path, lease: SoftFileLease) -> BlockingIOError:
    owner = lease.owner
    holder = "another process" if owner is None else f"process {owner.pid} on {owner.hostname}"
    return BlockingIOError(
        f"{target}: {holder} is making it, and two at once would mix their results; wait for that "
        f"process or end it, then run again. If there is no such process, delete {path}"
    )


def locate_lease(target: StrPath) -> Path:
    """The file of the lease of ``target``: hidden, beside it."""
    whole = Path(target).absolute()
    return whole.with_name(f".{whole.name}.lease")


def _is_held_here(lease: SoftFileLease) -> bool:
    # In a container filelock adds the namespace of process numbers to the name: that holder cannot be asked.
    return (owner := lease.owner) is not None and owner.hostname == socket.gethostname()


def _end_process(lost: LeaseCompromise) -> None:
    log.error(
        "%s: the lease was lost (%s); this process ends, or two would write", lost.lock_file, lost.reason
    )
    os.kill(os.getpid(), signal.SIGTERM)
