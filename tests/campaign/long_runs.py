"""Long runs: does the live view, or a fit, need more memory or time after an hour than after some minutes?

Usage: ``python -m tests.campaign.long_runs view SECONDS``, ``fit SECONDS`` or ``sockets COUNT``, with
``--seed SEED``, ``--out FILE`` and ``--within SHARE``. A small run is fitted first.

``view`` starts ``lagsplat view`` with two visitors. One reads pictures; the other drags, presses keys,
resets, pauses, changes inputs and edits, leaves and comes back, all at random. ``fit`` starts two processes
at once: one training of stage 1 that is longer than the time, and whole fits one after another in the other.
``sockets`` lets a crowd come to ``lagsplat view`` while somebody is there (`tests.campaign.crowd`), twice:
the first leaves behind what the server keeps for the next.

A process is sampled every few seconds into the table FILE. The median of the last tenth of the time is
compared with that of the second tenth: memory grows by at most SHARE, fits, or steps and pictures of the
view, cost at most that much more processor time, and no open files or kept files come on top. Other programs
run beside it, so processor time is measured in that of a fixed computation, made with every sample. After a
crowd the server is compared with before. Prints a verdict; the exit code is 1 if there is a finding. Linux
only.
"""

import argparse
import csv
import multiprocessing
import os
import random
import re
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, redirect_stderr
from dataclasses import asdict, dataclass, replace
from functools import partial
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

import lagsplat
from lagsplat.io.recording.recording import load_recording
from lagsplat.io.recording.segments import split_train_held_out
from lagsplat.processes import ends_with_this_process
from lagsplat.runs.fit import obtain_recording
from lagsplat.stage1 import fit as stage1
from lagsplat.stage1.linear_response import InputHistory
from lagsplat.viewer.server.handshake import LIMITS, MOST_VISITORS, SOCKETS_AT_ONCE, SOCKETS_HZ
from tests.campaign.crowd import Crowd, run_crowd
from tests.campaign.visitor import Visitor, act_at_random

SMALL = (  # a driven arm of 300 small frames
    *("profile=toy", "system=toy", "system.n_gaussians=128", "simulation.n_frames=300"),
    *("stage1.steps=200", "chart.visibility_frames=4"),
)
ENDLESS = ("stage1.steps=200000", "stage1.lifecycle.start=0.0", "stage1.checkpoint_every_s=5")
SAMPLES = 720  # of a run
ENOUGH = 50  # values of which some must be in every tenth
SMALL_MB = 1.0  # what may be added in any case: a checkpoint holds more late in a fit
MORE_THREADS = 4  # viser starts up to 32 workers as it needs them
START_S, END_S = 600.0, 60.0  # longest start and end of a process
STORM_S = 40.0  # of a crowd
GONE_S = 60.0  # within which a crowd is gone and a late visitor sees pictures
GAP_S = 10.0  # longest time without a picture for whoever was there before a crowd
SLACK_S = 15.0  # of the server's own limits of time, on a busy machine
REST_SAMPLES = 10
FIRST_CROWD = 0.15  # share of memory that may be kept for the next one
MB = 2.0**20
COMMAND = "import sys; from lagsplat.cli.main import main; sys.exit(main(sys.argv[1:]))"


@dataclass(frozen=True)
class Sample:
    """A process at one moment. ``own_mb`` is memory that no file backs; ``done`` counts since the start."""

    run: str
    after_s: float
    rss_mb: float
    pss_mb: float
    own_mb: float
    threads: int
    open_files: int
    cpu_s: float
    done: int
    pictures: int
    kept_files: int
    kept_mb: float
    yardstick_ms: float


def read_process(number: int) -> dict[str, Any]:
    """Memory, threads, open files and processor time of a process.

    Raises:
        OSError: it has ended.
    """
    place = Path(f"/proc/{number}")
    memory = dict(re.findall(r"^(\w+): +(\d+) kB", (place / "smaps_rollup").read_text(), flags=re.MULTILINE))
    fields = (place / "stat").read_text().rpartition(")")[2].split()
    return {
        "rss_mb": int(memory["Rss"]) / 1024,
        "pss_mb": int(memory["Pss"]) / 1024,
        "own_mb": int(memory["Anonymous"]) / 1024,
        "threads": int(fields[17]),
        "open_files": len(os.listdir(place / "fd")),
        "cpu_s": (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK"),
    }


def measure_yardstick() -> float:
    """Processor time of a fixed computation [ms]: what shares the core and its caches slows it as well."""
    numbers = np.linspace(0.0, 1.0, 20_000)
    began = time.thread_time()
    for _ in range(20):
        np.sort(np.sin(37.0 * numbers))
        sum(range(5_000))
    return 1e3 * (time.thread_time() - began)


def measure_folder(folder: Path) -> tuple[int, float]:
    """Number and size [MB] of the files of a folder; one may vanish meanwhile."""
    sizes = []
    for path in folder.rglob("*"):
        try:
            sizes.append(path.stat().st_size if path.is_file() else None)
        except FileNotFoundError:
            continue
    sizes = [size for size in sizes if size is not None]
    return len(sizes), sum(sizes) / MB


class Watch:
    """Samples of one process, kept in a table while they come."""

    def __init__(self, run: str, number: int, folder: Path, count: Callable[[], tuple[int, int]]) -> None:
        self.run, self.number, self.folder, self.count = run, number, folder, count
        self.samples: list[Sample] = []
        self.began_s: float | None = None

    def take(self) -> Sample:
        """Take a sample.

        Raises:
            OSError: the process has ended.
        """
        self.began_s = self.began_s or time.monotonic()
        now = time.monotonic() - self.began_s
        done, pictures = self.count()
        kept, size = measure_folder(self.folder)
        values = {**read_process(self.number), "done": done, "pictures": pictures, "kept_files": kept}
        values |= {"kept_mb": size, "yardstick_ms": measure_yardstick()}
        self.samples.append(Sample(self.run, now, **values))
        return self.samples[-1]


def write_samples(watches: Sequence[Watch], out: Path | None) -> None:
    """Write the samples of all processes as a table."""
    if out is None:
        return
    rows = [asdict(sample) for watch in watches for sample in watch.samples]
    with out.open("w", newline="", encoding="utf-8") as file:
        table = csv.DictWriter(file, fieldnames=list(Sample.__dataclass_fields__))
        table.writeheader()
        table.writerows(
            {k: round(v, 3) if isinstance(v, float) else v for k, v in row.items()} for row in rows
        )


def list_costs(samples: Sequence[Sample]) -> list[tuple[float, float]]:
    """Times [s] at which more was done, and the processor time since then, over what it takes in the mean.

    That is a time of one step and one of one picture, in yardsticks, by least squares over all samples: a
    less busy machine draws more pictures for the same steps.
    """
    times, costs, units, before = list[float](), list[float](), list[list[int]](), samples[0]
    for sample in samples[1:]:
        if sample.done > before.done:
            times.append(sample.after_s)
            costs.append((sample.cpu_s - before.cpu_s) / (1e-3 * sample.yardstick_ms))
            units.append([sample.done - before.done, sample.pictures - before.pictures])
            before = sample
    if not times:
        return []
    made = np.array(units, dtype=float)
    mean = made @ np.linalg.lstsq(made, np.array(costs))[0]
    return list(zip(times, (np.array(costs) / mean).tolist(), strict=True))


def judge(samples: Sequence[Sample], within: float) -> list[str]:
    """Compare the last tenth with the second; print both, return the findings."""
    end_s, run, findings = samples[-1].after_s, samples[0].run, list[str]()

    def compare(what: str, values: Sequence[tuple[float, float]], most: Callable[[float], float]) -> None:
        early = [value for at, value in values if 0.1 * end_s <= at <= 0.2 * end_s]
        late = [value for at, value in values if at >= 0.9 * end_s]
        if not early or not late:
            print(f"{run}: {what}: {len(values)} values, none in one of the tenths", flush=True)
            findings.extend([f"{run}: {what}: nothing late"] if not late and len(values) >= ENOUGH else [])
            return
        first, last = median(early), median(late)
        print(f"{run}: {what} {first:.4g} -> {last:.4g} ({len(early)} and {len(late)} values)", flush=True)
        findings.extend([f"{run}: {what} grew from {first:.4g} to {last:.4g}"] if last > most(first) else [])

    def column(name: str) -> list[tuple[float, float]]:
        return [(sample.after_s, getattr(sample, name)) for sample in samples]

    for name in ("rss_mb", "own_mb", "kept_mb"):
        compare(name, column(name), lambda first: (1.0 + within) * first + SMALL_MB)
    compare("processor time over its mean", list_costs(samples), lambda first: first / (1.0 - within))
    compare("threads", column("threads"), lambda first: first + MORE_THREADS)
    for name in ("open_files", "kept_files"):
        compare(name, column(name), lambda first: first + 1)  # one may be written when a sample is taken
    return findings if samples[-1].done else [*findings, f"{run}: nothing was done"]


def watch_all(watches: Sequence[Watch], seconds: float, out: Path | None) -> list[str]:
    """Sample processes for some time; returns those that have ended before."""
    every_s = seconds / SAMPLES if seconds > SAMPLES else min(1.0, seconds / 40)
    end = time.monotonic() + seconds
    while (left := end - time.monotonic()) > 0.0:
        time.sleep(min(left, every_s))
        for watch in watches:
            try:
                watch.take()
            except (OSError, KeyError):
                return [f"{watch.run}: the process has ended {end - time.monotonic():.0f} s too early"]
        write_samples(watches, out)
    return []


def make_small_run(folder: Path) -> None:
    """Fit a small run in a folder."""
    lagsplat.fit_run(lagsplat.compose(*SMALL), out=folder)


@contextmanager
def serve(folder: Path) -> Iterator[tuple["subprocess.Popen[str]", str]]:
    """``lagsplat view`` in a process of its own, and its address; its messages go to a file."""
    command = [sys.executable, "-W", "ignore", "-c", COMMAND, "view", str(folder), "--no-browser"]
    with (folder.parent / "view.log").open("w") as log:
        streams = {"stdout": subprocess.PIPE, "stderr": log, "text": True}
        server = subprocess.Popen([*command, "viewer.port=0"], **streams, **ends_with_this_process())
    with server:
        try:
            assert server.stdout is not None
            address = re.search(r"http://\S+", server.stdout.readline())
            if address is None:
                raise ChildProcessError((folder.parent / "view.log").read_text()[-2000:])
            yield server, address[0]
        finally:
            server.kill()


def end_server(server: "subprocess.Popen[str]") -> list[str]:
    """End a server by SIGTERM; what is wrong with its end."""
    if server.poll() is not None:
        return [f"the server ended before, with {server.returncode}"]
    began = time.monotonic()
    server.send_signal(signal.SIGTERM)
    try:
        code = server.wait(END_S)
    except subprocess.TimeoutExpired:
        return [f"the server goes on {END_S:.0f} s after SIGTERM"]
    print(f"view: ended by SIGTERM with {code} after {time.monotonic() - began:.1f} s", flush=True)
    return [] if code == 0 else [f"the server ends with {code}"]


def run_view(seconds: float, seed: int, place: Path, within: float, out: Path | None) -> list[str]:
    """Visit the live view of ``place/run`` for some time; returns the findings."""
    dt_s = float(np.diff(load_recording(place / "run" / "recording.safetensors").time_s[:2])[0])
    with serve(place / "run") as (server, url):
        reader, restless = Visitor(url), Visitor(url)
        stopping = threading.Event()
        threads = [
            threading.Thread(target=reader.keep_reading, args=(stopping,)),
            threading.Thread(target=act_at_random, args=(restless, random.Random(seed), stopping)),
        ]
        for thread in threads:
            thread.start()
        watch = Watch(
            "view", server.pid, place / "run", lambda: (round(reader.model_s / dt_s), reader.pictures)
        )
        findings = watch_all([watch], seconds, out)
        stopping.set()
        for thread in threads:
            thread.join(END_S)
        print(f"view: {dict(restless.acts)}; the reader came {reader.visits} times", flush=True)
        findings += (
            end_server(server) if server.poll() is None else [f"the server ended: {server.returncode}"]
        )
    log = (place / "view.log").read_text()
    findings += [f"the server's log: {log[-2000:]}"] if "Traceback" in log else []
    return findings + judge(watch.samples, within)


def train_endlessly(place: str, done: "Synchronized[int]") -> None:
    """Train stage 1 with more steps than fit in the time, counting them; checkpoints are kept."""
    experiment = lagsplat.compose(*SMALL, *ENDLESS)
    made, _ = obtain_recording(experiment)
    train, _ = split_train_held_out(made, experiment.recording.split).split()
    take_step = stage1.train_step

    def count_step(*words: Any) -> np.ndarray:
        done.value += 1
        return take_step(*words)

    stage1.train_step = count_step
    checkpoint, history = Path(place) / "state.pt", InputHistory(train.inputs, train.segments)
    stage1.fit_autoencoder(train.frames, experiment.stage1, seed=0, checkpoint=checkpoint, history=history)


def fit_repeatedly(place: str, done: "Synchronized[int]") -> None:
    """Fit the small run over and over into one folder, counting the fits."""
    while True:
        make_small_run(Path(place))
        done.value += 1


def run_in_silence(act: "Fit", place: str, done: "Synchronized[int]") -> None:
    """Run what has a progress bar."""
    with open(os.devnull, "w") as nowhere, redirect_stderr(nowhere):
        act(place, done)


Fit = Callable[[str, "Synchronized[int]"], None]  # fits in a folder until it is ended, and counts
FITS: dict[str, Fit] = {"training": train_endlessly, "fits": fit_repeatedly}


def run_fits(
    seconds: float, place: Path, within: float, out: Path | None, fits: Mapping[str, Fit] = FITS
) -> list[str]:
    """Fit for some time, a process each; returns the findings."""
    context = multiprocessing.get_context("spawn")
    watches, processes, counts = [], [], []
    try:
        for run, act in fits.items():
            folder, done = place / run, context.Value("q", 0)
            folder.mkdir()
            process = context.Process(target=run_in_silence, args=(act, str(folder), done), daemon=True)
            process.start()
            processes.append(process)
            counts.append(done)
            watches.append(Watch(run, process.pid, folder, partial(count_once, done)))
        end = time.monotonic() + START_S
        while not all(done.value for done in counts) and time.monotonic() < end:
            if not all(process.is_alive() for process in processes):
                break  # `watch_all` tells
            time.sleep(0.1)  # modules are loaded, kernels compiled
        findings = watch_all(watches, seconds, out)
    finally:
        for process in processes:
            process.kill()
            process.join(END_S)
    return findings + [text for watch in watches for text in judge(watch.samples, within)]


def count_once(done: "Synchronized[int]") -> tuple[int, int]:
    """What was done, as `Watch` asks for it."""
    return done.value, 0


def raise_limit(files: int) -> None:
    """Raise the limit of open files of this process, and of those it starts from now on.

    Raises:
        OSError: the hard limit is lower.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if hard != resource.RLIM_INFINITY and hard < files:
        raise OSError(f"{files} open files are needed, and the hard limit is {hard}: raise it, ulimit -Hn")
    if soft != resource.RLIM_INFINITY:
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, files), hard))


def settle(watch: Watch, files: int, within_s: float) -> float:
    """Wait until a process has no more open files than that; returns how long it took [s]."""
    began = time.monotonic()
    while watch.take().open_files > files and time.monotonic() - began < within_s:
        time.sleep(0.5)
    return time.monotonic() - began


def rest(watch: Watch) -> Sample:
    """A sample of a process at rest: the median of its memory over some seconds."""
    samples = []
    for _ in range(REST_SAMPLES):
        time.sleep(0.5)
        samples.append(watch.take())
    values = {name: median(getattr(one, name) for one in samples) for name in ("rss_mb", "own_mb")}
    return replace(samples[-1], **values, threads=max(one.threads for one in samples))


def storm(watch: Watch, reader: Visitor, url: str, count: int, seconds: float, seed: int) -> Crowd:
    """Let a crowd come while a process is watched and a visitor reads; returns what the crowd met."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        crowd = pool.submit(run_crowd, url, count, seconds, seed)
        while not crowd.done():
            watch.take()
            reader.ping()
            time.sleep(0.25)
        return crowd.result()


def judge_crowd(crowd: Crowd, seconds: float) -> list[str]:
    """What the server should have answered otherwise; prints the answers."""
    for (kind, answer), number in sorted(crowd.answers.items()):
        print(f"sockets: {kind}: {answer} {number} times", flush=True)
    held = ", ".join(f"{kind} {value:.1f} s" for kind, value in sorted(crowd.longest_s.items()))
    print(f"sockets: held at most {held}; {crowd.most_inside} inside at once", flush=True)
    admitted = sum(number for (_, answer), number in crowd.answers.items() if answer == "101")
    most = SOCKETS_AT_ONCE + SOCKETS_HZ * seconds + 1
    findings = [f"{admitted} were let in, more than {most:.0f}"] if admitted > most else []
    for kind in ("wrong token", "wrong origin"):
        if crowd.answers[kind, "101"] or not crowd.answers[kind, "403"]:
            findings.append(f"{kind} was let in, or never turned away")
    if crowd.most_inside > MOST_VISITORS:
        findings.append(f"{crowd.most_inside} visitors at once, more than {MOST_VISITORS}")
    shaking, pinged = LIMITS["open_timeout"], LIMITS["ping_interval"] + LIMITS["ping_timeout"]
    bounds = {"half": shaking, "garbage": shaking, "silent": pinged + LIMITS["close_timeout"]}
    for kind, bound in bounds.items():
        if crowd.longest_s.get(kind, 0.0) > bound + SLACK_S:
            findings.append(f"{kind}: held for {crowd.longest_s[kind]:.1f} s, the limit is {bound:.0f} s")
    return findings


def compare_rest(name: str, first: Sample, last: Sample, within: float) -> list[str]:
    """What a process at rest has more than before; prints both."""
    findings = []
    for column, share, more in (
        *(("rss_mb", within, 0), ("own_mb", within, 0)),
        *(("open_files", 0.0, 0), ("threads", 0.0, MORE_THREADS)),
    ):
        values = getattr(first, column), getattr(last, column)
        print(f"sockets: {name}: {column} {values[0]:.4g} -> {values[1]:.4g}", flush=True)
        if values[1] > (1.0 + share) * values[0] + more:
            findings.append(f"{name}: {column} grew from {values[0]:.4g} to {values[1]:.4g}")
    return findings


def come_late(url: str) -> tuple[float, float]:
    """Time until a new visitor is served with pictures, and that of the whole page [s].

    Raises:
        OSError: the page or the pictures do not come.
    """
    began = time.monotonic()
    with urllib.request.urlopen(url, timeout=GONE_S) as answer:
        answer.read()
    page_s = time.monotonic() - began
    visitor, stopping = Visitor(url), threading.Event()
    thread = threading.Thread(target=visitor.keep_reading, args=(stopping,))
    thread.start()
    began = time.monotonic()
    while len(visitor.seen_s) < 3 and time.monotonic() - began < GONE_S:
        time.sleep(0.01)
    picture_s = time.monotonic() - began
    stopping.set()
    thread.join(END_S)
    if picture_s >= GONE_S:
        raise TimeoutError(f"no pictures within {GONE_S:.0f} s")
    return picture_s, page_s


def meet_crowd(watch: Watch, reader: Visitor, url: str, count: int, seed: int) -> list[str]:
    """Let a crowd come and go; prints what it met and what the reader saw, returns the findings."""
    files, calm = watch.take().open_files, reader.forget_times()
    findings = judge_crowd(storm(watch, reader, url, count, STORM_S, seed), STORM_S)
    stormy, gone_s = reader.forget_times(), settle(watch, files, GONE_S)
    print(f"sockets: the earlier visitor, before: {calm}; meanwhile: {stormy}", flush=True)
    most = max(sample.open_files for sample in watch.samples)
    print(f"sockets: {most} open files at most; gone after {gone_s:.1f} s", flush=True)
    if reader.visits > 1 or not stormy.gaps_s or max(stormy.gaps_s) > GAP_S:
        findings.append(f"the earlier visitor came {reader.visits} times and saw {stormy}")
    return findings


def run_sockets(count: int, seed: int, place: Path, within: float, out: Path | None) -> list[str]:
    """Let a crowd come twice to the view of ``place/run``, and another visitor later; returns findings."""
    with serve(place / "run") as (server, url):
        raise_limit(2 * count + 200)
        reader, stopping = Visitor(url), threading.Event()
        thread = threading.Thread(target=reader.keep_reading, args=(stopping,))
        thread.start()
        watch = Watch("sockets", server.pid, place / "run", lambda: (0, reader.pictures))
        rests, findings = [rest(watch)], []
        for turn in range(2):
            findings += meet_crowd(watch, reader, url, count, seed + turn)
            rests.append(rest(watch))
        # objects of the first crowd leave memory that the next one takes again
        findings += compare_rest("before and after", rests[0], rests[2], FIRST_CROWD)
        findings += compare_rest("first and second crowd", rests[1], rests[2], within)
        try:
            picture_s, page_s = come_late(url)
            print(f"sockets: a later one: page {page_s:.2f} s, served {picture_s:.2f} s", flush=True)
        except OSError as error:
            findings.append(f"a later visitor: {error}")
        stopping.set()
        thread.join(END_S)
        write_samples([watch], out)
        findings += end_server(server)
    log = (place / "view.log").read_text()
    print(f"sockets: {len(log)} characters of messages", flush=True)
    return findings + ([f"the server's messages: {log[-3000:]}"] if "Traceback" in log else [])


def main(words: Sequence[str] | None = None) -> int:
    """Run a campaign; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.campaign.long_runs")
    parser.add_argument("campaign", choices=("view", "fit", "sockets"))
    parser.add_argument("amount", type=float, help="seconds, or the number of sockets")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--within", type=float, default=0.05)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args(words)
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        if given.campaign != "fit":
            make_small_run(place / "run")
        if given.campaign == "view":
            findings = run_view(given.amount, given.seed, place, given.within, given.out)
        elif given.campaign == "fit":
            findings = run_fits(given.amount, place, given.within, given.out)
        else:
            findings = run_sockets(int(given.amount), given.seed, place, given.within, given.out)
    for text in findings:
        print(f"FINDING {text}", flush=True)
    print(f"{given.campaign} {given.amount:g}, seed {given.seed}: {len(findings)} findings", flush=True)
    return 1 if findings else 0


if __name__ == "__main__":
    sys.exit(main())
