"""Every writer of files on a disk that fails at its first operation, at its second, and so on to the last.

Usage: ``LD_PRELOAD=./shim.so python -m tests.campaign.failing_writes [writer ...]``, the library made of
`failing_writes.c`. After each failure the earlier file must be whole, or the new one, and nothing may lie
beside it. The error must be an `OSError` that names the file; there may be none where the new file is whole.
Prints a line for each writer and error, and one for everything that is not so; then the exit code is 1.
"""

import ctypes
import errno
import json
import os
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import torch

from lagsplat.io.files import tracking
from lagsplat.io.files.artifact import save_artifact
from lagsplat.io.files.atomic import copy_file, save_csv, save_json, write_text
from lagsplat.io.files.checkpoint import save_checkpoint
from lagsplat.io.files.pipeline_copy import copy_pipeline
from lagsplat.io.files.ply import PlyCloud, write_cloud
from lagsplat.io.robot_log.write import COLUMNS, SessionLog, save_session
from lagsplat.io.trajectory.sysid_series import POSITION, Signal, write_series
from lagsplat.io.video.image_sequence import write_dnerf
from lagsplat.io.video.write import save_gif, save_mp4
from lagsplat.report.common.style import save_figure

ERRORS = (errno.ENOSPC, errno.EIO, errno.EDQUOT, errno.EROFS)
MANY, MOST_OPERATIONS = 30, 4000
PICTURES = np.random.default_rng(0).integers(0, 255, (6, 32, 48, 3), dtype=np.uint8)
WRITERS: dict[str, Callable[[Path], object]] = {
    "text.txt": lambda path: write_text(path, "text" * 5000),
    "table.csv": lambda path: save_csv(path, [{"t": i, "q0": i / 3} for i in range(2000)]),
    "copy.bin": lambda path: copy_file(Path(__file__), path),
    "record.json": lambda path: save_json(path, {"a": list(range(3000))}),
    "model.safetensors": lambda path: save_artifact(
        path,
        {"a": np.ones(9000), "b": np.ones((3, 4), np.float32)},
        {"kind": "test", "schema": 1, "stamp": ""},
    ),
    "state.pt": lambda path: save_checkpoint(path, {"w": torch.ones(5000)}, identity="a"),
    "cloud.ply": lambda path: write_cloud(
        path,
        PlyCloud(np.ones((99, 3)), np.ones((99, 3)), np.ones((99, 4)), np.ones((99, 3)), np.ones(99) / 2),
    ),
    "series.npz": lambda path: write_series(path, np.arange(999.0), [Signal("q", POSITION, np.ones(999))]),
    "film.mp4": lambda path: save_mp4(path, PICTURES, rate_hz=10.0),
    "film.gif": lambda path: save_gif(path, PICTURES, rate_hz=10.0),
    "figure.pdf": lambda path: save_figure(path, plt.figure(num=1, clear=True)),
    "figure.png": lambda path: save_figure(path, plt.figure(num=1, clear=True)),
    "session.mcap": lambda path: save_session(
        path, SessionLog(0.1, {name: np.zeros((200, 2)) for name in COLUMNS})
    ),
    "dnerf": lambda path: write_dnerf(path, PICTURES, n_train=3, field_of_view_rad=0.5, distance=2.0),
    "pipeline": copy_pipeline,
    "tracking.jsonl": lambda path: tracking.track(
        "jsonl", [{"step": 0, "loss": 0.5}], run="a", rule="b", settings={"c": 1}
    ),
}
ANEW = ("session.mcap", "pipeline", "dnerf")
"""What replaces no file: a writer that refuses a target which is there, or a folder of many files."""
APPENDED = ("tracking.jsonl",)
EARLIER = b"what was there before\n"


class Shim:
    """The library in this process."""

    def __init__(self) -> None:
        library = ctypes.CDLL(None)
        self._arm, self._disarm = library.fault_arm, library.fault_disarm
        self._arm.argtypes = (ctypes.c_char_p, ctypes.c_long, ctypes.c_int)

    def fails_at(self, operation: int, error: int, folder: Path, work: Callable[[], object]) -> tuple:
        """Do the work; whether a fault happened, and what was raised."""
        raised: Exception | None = None
        self._arm(os.fsencode(folder), operation, error)
        try:
            work()
        except Exception as found:
            raised = found
        return bool(self._disarm()), raised


def content_of(target: Path) -> dict[str, bytes]:
    """Every file at or below the target, by its place."""
    files = [target] if target.is_file() else sorted(path for path in target.rglob("*") if path.is_file())
    return {str(path.relative_to(target.parent)): _sorted(path.read_bytes(), path.suffix) for path in files}


def _sorted(content: bytes, suffix: str) -> bytes:
    if suffix != ".safetensors" or content == EARLIER:
        return content
    end = 8 + int.from_bytes(content[:8], "little")  # the library writes its metadata in any order
    return json.dumps(json.loads(content[8:end]), sort_keys=True).encode() + content[end:]


def faults_of(name: str, error: int, shim: Shim) -> tuple[int, list[str]]:
    """How many operations a writer has, and what is wrong after a failure at each of them."""
    write, wrong, whole = WRITERS[name], [], undisturbed(name)
    for operation in (*range(1, MANY), *range(MANY, MOST_OPERATIONS, 197)):
        with tempfile.TemporaryDirectory() as place:
            folder = Path(place).resolve()
            target = tracking.LINES = folder / "results" / name
            if name not in ANEW:
                target.parent.mkdir()
                target.write_bytes(EARLIER)
            happened, raised = shim.fails_at(operation, error, folder, partial(write, target))
            if not happened:
                break
            found = judge(name, target, whole, raised)
            wrong += [f"{name}, {errno.errorcode[error]} at {operation}: {what}" for what in found]
    return operation - 1, wrong


def undisturbed(name: str) -> dict[str, bytes]:
    """What a writer leaves on a disk that works."""
    with tempfile.TemporaryDirectory() as place:
        target = tracking.LINES = Path(place).resolve() / "results" / name
        WRITERS[name](target)
        return content_of(target)


def judge(name: str, target: Path, whole: dict[str, bytes], raised: Exception | None) -> Iterator[str]:
    """What is wrong after one failure."""
    if raised is not None and not isinstance(raised, OSError):
        yield f"{type(raised).__name__}: {raised}"
    elif raised is not None and not any(str(path) in str(raised) for path in (target, target.parent)):
        yield f"the error does not name the file: {raised}"
    after = content_of(target)
    if name in APPENDED:
        if not after[name].startswith(EARLIER):
            yield "earlier lines are lost"
    elif raised is None and after != whole:
        yield "no error, and not the whole content"
    elif raised is not None and name not in ANEW and after not in (whole, {name: EARLIER}):
        yield "neither the earlier file nor the whole new one"
    if beside := [path.name for path in target.parent.glob(".*")]:
        yield f"left beside it: {beside}"


def main(names: list[str]) -> int:
    warnings.simplefilter("ignore")
    shim, found = Shim(), 0
    for name in names or WRITERS:
        for error in ERRORS:
            operations, wrong = faults_of(name, error, shim)
            print(
                f"{name:20} {errno.errorcode[error]}: {operations} operations, {len(wrong)} wrong", flush=True
            )
            found += len(wrong)
            for line in wrong[:6]:
                print(f"  {line}", flush=True)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
