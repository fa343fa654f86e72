"""Damaged inputs: files of every kind that is read, mutated at random, tried in processes with bounds.

Usage: ``python -m tests.campaign.inputs SEED COUNT [format ...] [--counts FILE]``. Input number ``i`` of a
format depends on seed, format and ``i`` alone. A reader may take an input or refuse it with a `ValueError` or
an `OSError`; `lagsplat inspect` ends with 0 or 2. Anything else is a finding: another error, a crash, more
than `MOST_S` or `MOST_MB`, or a file that appears beside the input. A process tries `RENEWED` inputs, one
after another; what it finds, or does not survive, is tried again in a process of its own. Prints examples of
each kind of finding and a count for each format, which ``--counts`` adds to a table; the exit code is 1 if
there is a finding.
"""

import argparse
import csv
import io
import json
import logging
import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from lagsplat.cli.main import main as lagsplat
from lagsplat.io.files.artifact import load_artifact, save_artifact
from lagsplat.io.files.ply import PlyCloud, read_cloud, read_sharp, write_cloud
from lagsplat.io.files.sysid_yaml import SysidParameter, read_sysid_parameters, write_sysid_parameters
from lagsplat.io.mujoco.model import load_mujoco
from lagsplat.io.recording.recording import Recording, load_recording, save_recording
from lagsplat.io.robot_log.write import COLUMNS, SessionLog, save_session
from lagsplat.io.sources import find_sources, read_sources
from lagsplat.io.video.write import save_mp4
from tests.unit.pipelines.test_every_kind_of_file import (
    record,
    write_hdf5,
    write_matlab,
    write_mcap,
    write_robomimic,
    write_sqlite_bag,
    write_sysid_series,
)

MOST_S, MOST_MB = 20, 1500  # of a processor and of memory, for one input; more is a finding
PATIENCE_S = 600  # by the clock: a busy machine may need more than `MOST_S`
RENEWED = 250  # inputs of one process
READS = (ValueError, OSError)  # what a reader may raise
NUMBERS = (
    *("nan", "inf", "-inf", "1e308", "-1e308", "1e-320", "0", "-0.0", "-1", "1e400", "9" * 40),
    *("", "x", "null", "true", "[]", "{}", '"text"', "0x10", "1,5", "\u0663", " "),
)
VALUES = (
    *(None, True, -1, 0, 10**30, 1e308, -1e-320, float("nan"), float("inf")),
    *("", "text", [], {}, [[]], [1, "a"]),
)
ARM = """<mujoco><option timestep="0.01"/><worldbody><body><joint name="q0" axis="0 1 0" damping="0.1"/>
<geom type="capsule" size="0.02 0.2" pos="0 0 -0.2" mass="1"/><body pos="0 0 -0.4">
<joint name="q1" axis="0 1 0" stiffness="3"/><geom size="0.05" mass="0.5"/></body></body></worldbody>
<actuator><motor name="u0" joint="q0"
gear="2"/></actuator></mujoco>
"""


def inspect(path: Path) -> None:
    """`lagsplat inspect`, which ends with 0 or 2; a film's sheet goes elsewhere."""
    with tempfile.TemporaryDirectory() as elsewhere:
        code = lagsplat(["inspect", str(path), f"sheet={elsewhere}/sheet.png"])
    assert code in (0, 2), f"lagsplat inspect ends with {code}"


def read(path: Path) -> None:
    """What `lagsplat diagnose` does with a file that is named to it."""
    read_sources(find_sources(str(path)))


def write_csv(folder: Path) -> Path:
    log = record()
    table = pd.DataFrame({"t": log.t, "q0": log.q, "v0": log.v, "u0": np.sin(log.t), "segment": 0})
    table[:60].to_csv(folder / "log.csv", index=False, float_format="%.5f")
    return folder / "log.csv"


def write_parquet(folder: Path) -> Path:
    log = record()
    pd.DataFrame({"t": log.t, "q0": log.q}).to_parquet(folder / "log.parquet")
    return folder / "log.parquet"


def write_npz(folder: Path) -> Path:
    log = record()
    np.savez(folder / "log.npz", t=log.t[:60], q=log.q[:60, None], u=np.ones((60, 1)))
    return folder / "log.npz"


def write_krauss(folder: Path) -> Path:
    images = np.random.default_rng(0).integers(0, 255, (40, 3, 12, 12), dtype=np.uint8)
    np.savez(folder / "film.npz", images=images, p1=np.ones(40), p2=np.zeros(40))
    return folder / "film.npz"


def write_mp4(folder: Path) -> Path:
    x, time_s = np.arange(48)[None, None], np.arange(40)[:, None, None]
    grey = np.broadcast_to(128 + 100 * np.sin(x / 5 + time_s / 4), (40, 32, 48)).astype(np.uint8)
    save_mp4(folder / "film.mp4", np.repeat(grey[..., None], 3, axis=3), rate_hz=30.0)
    return folder / "film.mp4"


def write_session(folder: Path) -> Path:
    save_session(folder / "session.mcap", SessionLog(0.1, {name: np.zeros((20, 2)) for name in COLUMNS}))
    return folder / "session.mcap"


def write_ply(folder: Path) -> Path:
    write_cloud(
        folder / "cloud.ply", PlyCloud(*(np.full((9, k), 0.5) for k in (3, 3, 4, 3)), np.full(9, 0.5))
    )
    return folder / "cloud.ply"


def write_yaml(folder: Path) -> Path:
    one = SysidParameter("mass", *(np.array([x]) for x in (1.0, 1.1, 0.5, 2.0)))
    write_sysid_parameters(folder / "parameters.yaml", [one, SysidParameter("gain", *(np.ones(2),) * 4)])
    return folder / "parameters.yaml"


def write_mjcf(folder: Path) -> Path:
    (folder / "arm.xml").write_text(ARM, encoding="utf-8")
    return folder / "arm.xml"


def write_recording(folder: Path) -> Path:
    frames = np.random.default_rng(0).integers(0, 255, (12, 8, 8, 3), dtype=np.uint8)
    meta = {"origin": "filmed", "sha256": "0", "licence": "none", "source": "a.mp4"}
    film = Recording(frames, np.arange(12) / 30, np.ones((12, 1)), ("u0",), ("N",), meta=meta)
    save_recording(folder / "film.safetensors", film)
    return folder / "film.safetensors"


Writer = Callable[[Path], Path]
Reader = Callable[[Path], object]
FORMATS: dict[str, tuple[Writer, Sequence[Reader]]] = {
    "csv": (write_csv, (inspect, read)),
    "parquet": (write_parquet, (inspect, read)),
    "npz": (write_npz, (inspect, read)),
    "krauss": (write_krauss, (inspect,)),
    "sysid": (lambda folder: write_sysid_series(folder, record()), (inspect, read)),
    "mat": (lambda folder: write_matlab(folder, record()), (inspect, read)),
    "hdf5": (lambda folder: write_hdf5(folder, record()), (inspect, read)),
    "robomimic": (lambda folder: write_robomimic(folder, record()), (inspect, read)),
    "mcap": (lambda folder: write_mcap(folder, record()), (inspect, read)),
    "db3": (lambda folder: next(write_sqlite_bag(folder, record()).glob("*.db3")), (inspect, read)),
    "session": (write_session, (inspect, read)),
    "mp4": (write_mp4, (inspect,)),
    "ply": (write_ply, (read_cloud, read_sharp)),
    "yaml": (write_yaml, (read_sysid_parameters,)),
    "mjcf": (write_mjcf, (inspect, load_mujoco)),
    "safetensors": (write_recording, (inspect, load_recording)),
}


def flip_bits(data: bytes, rng: random.Random) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8, 64))):
        bit = rng.randrange(8 * len(changed))
        changed[bit // 8] ^= 1 << bit % 8
    return bytes(changed)


def truncate(data: bytes, rng: random.Random) -> bytes:
    return data[: rng.choice((rng.randrange(len(data)), rng.randrange(min(len(data), 200)), len(data) - 1))]


def splice(data: bytes, rng: random.Random) -> bytes:
    """Put a piece somewhere else, over or between what is there."""
    size = rng.randrange(1, min(len(data), 2000))
    start, place = rng.randrange(len(data) - size + 1), rng.randrange(len(data))
    return data[:place] + data[start : start + size] + data[place + rng.choice((0, size)) :]


def fill(data: bytes, rng: random.Random) -> bytes:
    size, place = rng.randrange(1, min(len(data), 500)), rng.randrange(len(data))
    filling = rng.choice((b"\x00" * size, b"\xff" * size, rng.randbytes(size)))
    return data[:place] + filling + data[place + size :]


def change_words(data: bytes, rng: random.Random) -> bytes:
    """Other numbers and names in a text; whatever comes in a binary file."""
    words = list(re.finditer(rb"-?\d[\d.eE+-]*|[A-Za-z_]\w+", data))
    for _ in range(rng.choice((1, 1, 2, 5))):
        if not words:
            return fill(data, rng)
        word = rng.choice(words)
        other = rng.choice((rng.choice(NUMBERS).encode(), rng.choice(words).group(), word.group() * 2))
        data = data[: word.start()] + other + data[word.end() :]
        words = [each for each in words if each.end() <= word.start()]
    return data


def swap_lines(data: bytes, rng: random.Random) -> bytes:
    lines = data.split(b"\n")
    for _ in range(rng.choice((1, 2, 10))):
        i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
        lines[i], lines[j] = lines[j], lines[i]
    return b"\n".join(lines[: rng.choice((len(lines), max(1, len(lines) // 2)))])


def odd_array(array: np.ndarray, rng: random.Random) -> np.ndarray:
    """An array of another shape, type or content, as another program might write it."""
    flat = np.array(array, copy=True)
    if not flat.ndim:
        return rng.choice((flat[None], flat.astype(str), np.array(rng.choice(NUMBERS))))
    if flat.size and flat.dtype.kind == "f" and rng.random() < 0.5:
        flat.reshape(-1)[rng.randrange(flat.size)] = float(rng.choice(NUMBERS[:9]))
        return flat
    if flat.dtype.kind in "US":
        return rng.choice((np.array(rng.choice(NUMBERS)), flat.reshape(-1), np.array(["a", "b"]), np.ones(3)))
    return rng.choice(
        (
            lambda: flat[:0],
            lambda: flat[:1],
            lambda: flat[::-1],
            lambda: flat[..., None],
            lambda: flat.reshape(-1),
            lambda: flat.T,
            lambda: flat.astype(str),
            lambda: flat.astype(np.complex128),
            lambda: flat.astype(np.int8),
            lambda: flat.astype(">f8"),
            lambda: flat.astype(np.float16),
            lambda: flat.astype(bool),
            lambda: np.zeros_like(flat),
            lambda: np.array(3.0),
            lambda: np.repeat(flat, 2, axis=0) if flat.ndim else flat,
        )
    )()


def change_npz(data: bytes, rng: random.Random) -> bytes:
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        arrays = dict(archive)
    names = list(arrays)
    for _ in range(rng.choice((1, 1, 2))):
        name = rng.choice(names)
        change = rng.randrange(4)
        if change == 0 and len(arrays) > 1:
            arrays.pop(name, None)
        elif change == 1:
            arrays[rng.choice((*names, "q", "t", "x" * 300, ""))] = arrays.get(name, np.zeros(3))
        elif name in arrays:
            arrays[name] = odd_array(arrays[name], rng)
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def odd_value(value: object, rng: random.Random) -> object:
    """Plain data with one place changed."""
    if isinstance(value, dict) and value and rng.random() < 0.85:
        key = rng.choice(list(value))
        if rng.random() < 0.1:
            return {other: content for other, content in value.items() if other != key}
        return {**value, key: odd_value(value[key], rng)}
    if isinstance(value, list) and value and rng.random() < 0.85:
        place = rng.randrange(len(value))
        return [*value[:place], odd_value(value[place], rng), *value[place + 1 :]]
    return rng.choice(VALUES)


def change_artifact(data: bytes, rng: random.Random) -> bytes:
    """An artefact that another version might have written: other header, other tensors, right checksums."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.safetensors"
        path.write_bytes(data)
        tensors, header = load_artifact(path)
        if rng.random() < 0.5:
            name = rng.choice(list(tensors))
            array = odd_array(tensors[name], rng)
            tensors[name] = array if array.dtype.kind in "fiub" else tensors[name][:1]
        else:
            kind, schema = header["kind"], header["schema"]
            key = rng.choice(list(header))
            header = {**header, key: odd_value(header[key], rng), "kind": kind, "schema": schema}
        save_artifact(path, tensors, header)
        return path.read_bytes()


BYTES = (flip_bits, truncate, splice, fill)
TEXT = (change_words, change_words, swap_lines)
MUTATIONS = {
    "csv": (*BYTES, *TEXT, *TEXT),
    "yaml": (*BYTES, *TEXT, *TEXT),
    "mjcf": (*BYTES, *TEXT, *TEXT),
    "npz": (*BYTES, *[change_npz] * 6),
    "krauss": (*BYTES, *[change_npz] * 6),
    "sysid": (*BYTES, *[change_npz] * 6),
    "ply": (*BYTES, *TEXT),
    "session": (*BYTES, change_words),
    "safetensors": (*BYTES, *[change_artifact] * 6),
}


def mutated(kind: str, data: bytes, seed: int, number: int) -> bytes:
    """Input ``number`` of a format."""
    rng = random.Random(f"{seed} {kind} {number}")
    return rng.choice(MUTATIONS.get(kind, (*BYTES, change_words)))(data, rng)


def try_reader(path: Path, reader: Reader) -> str | None:
    """In a child process: what is wrong with how a reader takes an input; None if nothing is."""
    try:
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
            reader(path)
    except READS as error:
        if not str(error).strip():
            return f"an error without words: {type(error).__name__}"
    except BaseException as error:
        place = traceback.extract_tb(error.__traceback__)
        ours = [frame for frame in place if "lagsplat" in frame.filename] or place
        where = f"{Path(ours[-1].filename).name}:{ours[-1].lineno}"
        return f"{type(error).__name__} at {where}: {str(error)[:160]}"
    return None


def set_bounds() -> None:
    """In a child process: silence, and the bounds of memory and of numbers that warn."""
    for number in (1, 2):
        os.dup2(os.open("/dev/null", os.O_WRONLY), number)
    size = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (size + MOST_MB * 2**20,) * 2)
    warnings.simplefilter("ignore")  # of numbers out of range, and of what a file lacks


def within_time(path: Path, reader: Reader) -> str | None:
    """In a child process that is killed when a reader takes too long."""
    signal.setitimer(signal.ITIMER_PROF, MOST_S)
    signal.alarm(PATIENCE_S)
    found = try_reader(path, reader)
    signal.setitimer(signal.ITIMER_PROF, 0)
    signal.alarm(0)
    return found


def in_child(path: Path, reader: Reader) -> str | None:
    """The same in a process with bounds, of which the end is judged as well."""
    receive, send = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(receive)
        set_bounds()
        found = within_time(path, reader) or ""
        os.write(send, found.encode(errors="replace")[:4000])
        os._exit(0)
    os.close(send)
    with os.fdopen(receive, "rb") as pipe:
        found = pipe.read().decode()
    return describe_end(child) or found or None


def describe_end(child: int) -> str | None:
    """How a child process was killed; None if it ended by itself."""
    _, status = os.waitpid(child, 0)
    if not os.WIFSIGNALED(status):
        return None
    number = os.WTERMSIG(status)
    bounds = {
        signal.SIGPROF: f"more than {MOST_S} s of a processor",
        signal.SIGALRM: f"longer than {PATIENCE_S} s",
    }
    return bounds.get(number) or signal.Signals(number).name


@dataclass(frozen=True)
class Original:
    """A whole file of a format, what is read of it, and the folder in which its mutations lie."""

    kind: str
    name: str
    data: bytes
    place: Path

    def try_input(
        self, seed: int, number: int, attempt: Callable[[Path, Reader], str | None]
    ) -> dict[str, str]:
        """What is wrong with how the readers take one input, by their names."""
        folder = Path(tempfile.mkdtemp(dir=self.place))
        path, wrong = folder / self.name, {}
        path.write_bytes(mutated(self.kind, self.data, seed, number))
        os.chdir(folder)
        for reader in FORMATS[self.kind][1]:
            name = getattr(reader, "__name__", str(reader))
            if found := attempt(path, reader):
                wrong[name] = found
            if [each.name for each in folder.iterdir()] != [path.name]:
                wrong[name] = "a file appeared beside the input"
        os.chdir("/")
        shutil.rmtree(folder)
        return wrong


class Worker:
    """A process that tries one input after another, until one ends it."""

    def __init__(self, original: Original, seed: int) -> None:
        (asks, self._ask), (self._answer, answers) = os.pipe(), os.pipe()
        self.tried, self.child = 0, os.fork()
        if self.child == 0:
            os.close(self._ask), os.close(self._answer)
            try:
                set_bounds()
                with os.fdopen(asks) as numbers, os.fdopen(answers, "w") as told:
                    for line in numbers:
                        wrong = original.try_input(seed, int(line), within_time)
                        print(json.dumps(wrong), file=told, flush=True)
            finally:  # before the parent's context managers end here as well
                os._exit(0)
        os.close(asks), os.close(answers)
        self._answers = os.fdopen(self._answer)

    def try_input(self, number: int) -> dict[str, str] | None:
        """What is wrong with one input; None if the process has not survived it."""
        self.tried += 1
        os.write(self._ask, f"{number}\n".encode())
        line = self._answers.readline()
        return json.loads(line) if line else None

    def end(self) -> str | None:
        """Let the process end; how it was killed, if it was."""
        os.close(self._ask)
        self._answers.close()
        return describe_end(self.child)


def list_findings(original: Original, seed: int, numbers: Sequence[int]) -> Iterator[tuple[int, str, str]]:
    """Number, reader and what is wrong, of every input that is answered badly."""
    worker: Worker | None = None
    for number in numbers:
        worker = worker or Worker(original, seed)
        wrong = worker.try_input(number)
        if wrong is None or wrong:
            ended, worker = worker.end(), None
            alone = original.try_input(seed, number, in_child)
            found = alone or wrong or {"a reader": f"after others alone: {ended}"}
            # Memory may have been short because of the inputs before.
            if alone or not any("MemoryError" in each for each in found.values()):
                yield from ((number, reader, what) for reader, what in found.items())
        elif worker.tried == RENEWED:
            worker.end()
            worker = None
    if worker is not None:
        worker.end()


def run(kind: str, seed: int, numbers: Sequence[int]) -> Counter[str]:
    """Try the inputs of a format; findings are printed and counted by their kind."""
    write, readers = FORMATS[kind]
    findings: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as place:
        made = write(Path(place))
        for reader in readers:
            # Here first, so that no child has to load and compile what it needs.
            if wrong := try_reader(made, reader) or in_child(made, reader):
                raise SystemExit(f"{kind}: the unchanged file is not read: {wrong}")
        original = Original(kind, made.name, made.read_bytes(), Path(place))
        for number, reader, wrong in list_findings(original, seed, numbers):
            told = re.sub(r"/\S+|\d+", "#", wrong)[:90]
            findings[told] += 1
            if findings[told] <= 2:
                print(f"  ONE {kind} {seed} {number}, {reader}: {wrong}", flush=True)
    return findings


def main(words: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.campaign.inputs")
    parser.add_argument("seed", type=int)
    parser.add_argument("count", type=int)
    parser.add_argument("--counts", type=Path, help="a table to which the counts are added")
    parser.add_argument("formats", nargs="*", choices=[[], *FORMATS])
    given = parser.parse_args(words)
    warnings.simplefilter("ignore")
    logging.disable(logging.CRITICAL)
    cv2.setNumThreads(1)
    bad = 0
    for kind in given.formats or FORMATS:
        began = time.monotonic()
        findings = run(kind, given.seed, range(given.count))
        found, seconds = sum(findings.values()), round(time.monotonic() - began)
        bad += found
        print(f"{kind:12} {given.count} inputs, {found} findings, {seconds} s", flush=True)
        if given.counts:
            with given.counts.open("a", newline="", encoding="utf-8") as table:
                csv.writer(table).writerow([kind, given.seed, given.count, found, seconds])
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
