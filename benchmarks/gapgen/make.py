"""Make a split of recordings: ``python -m benchmarks.gapgen.make --split dev --key KEY --n 200 --out DIR``.

Writes ``DIR/data/<id>/sim_*.csv`` and ``real_0.csv``, with ``--tier T1`` one film a clip as ``sim_*.npz`` and
``real_*.npz`` (keys ``images`` and ``p1`` to ``pn``) and ``about.json`` with what whoever films a mechanism
knows, its number of coordinates and the seconds between frames; under position control it holds the inputs
that are targets, each with its coordinate. ``DIR/answers.jsonl`` gets the truth. Names
are random, files are written in their order and all carry the same time stamp.
"""

import argparse
import json
import os
import sys
import time
from dataclasses import replace
from multiprocessing import Pool
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.gapgen.answers import answer, reported
from benchmarks.gapgen.drawing import Recording, Stratum, draw
from benchmarks.gapgen.keys import read_key
from benchmarks.gapgen.render import FRAME_S, Camera, draw_look, film
from benchmarks.gapgen.strata import SYSTEMS, WIDE, identities, seed_of, strata

# one moment for every file: the first second of 2001
STAMP = 978_307_200
Task = tuple[str, Stratum, int, str, str, str]


def write_columns(path: Path, columns: dict[str, Any]) -> None:
    """Write equally long columns as CSV."""
    table = np.column_stack(list(columns.values()))
    whole = [name == "segment" for name in columns]
    fmt = ["%d" if w else "%.9g" for w in whole]
    np.savetxt(path, table, fmt=fmt, delimiter=",", header=",".join(columns), comments="")
    os.utime(path, (STAMP, STAMP))


def write_films(place: Path, recording: Recording, noise: float, rng: np.random.Generator) -> list[str]:
    """Write every clip as an archive of frames and inputs, and return their names."""
    look = draw_look(rng)
    camera = Camera()
    for effect in recording.truth["found"]:
        if effect.camera and effect.camera[0] == "image":
            camera = replace(camera, **effect.camera[1])
        elif effect.camera and effect.camera[0] == "blur":
            camera = replace(camera, exposure_s=effect.camera[1]["exposure"])
    names = []
    for stem, t0, q, u, real in recording.reels:
        view = camera if real else Camera()
        frames = film(recording.nominal, q, t0=t0, look=look, camera=view, noise=noise, rng=rng)
        inputs = {} if u is None else {f"p{j + 1}": u[:, j] for j in range(u.shape[1])}
        path = place / f"{stem}.npz"
        np.savez_compressed(path, images=frames, **inputs)
        os.utime(path, (STAMP, STAMP))
        names.append(path.name)
    write_about(place, {"coordinates": recording.reels[0][2].shape[1], "frame_s": FRAME_S})
    return names


def write_about(place: Path, known: dict[str, Any]) -> None:
    """Write what whoever makes a recording knows of it."""
    about = place / "about.json"
    about.write_text(json.dumps(known) + "\n", encoding="utf-8")
    os.utime(about, (STAMP, STAMP))


def drawn(stratum: Stratum, seed: int, *, film_hz: float | None = None) -> Recording:
    """The recording of a seed; a draw whose mechanism escapes is drawn anew.

    Raises:
        RuntimeError: if five draws in a row escape.
    """
    for attempt in range(5):
        try:
            return draw(stratum, np.random.default_rng([seed, attempt]), film_hz=film_hz)
        except FloatingPointError:
            continue
    raise RuntimeError(f"{stratum}: five draws in a row left every bound")


def make_one(task: Task) -> dict[str, Any]:
    """Write the files of one recording and return its answer."""
    identity, stratum, seed, split, folder, tier = task
    recording = drawn(stratum, seed, film_hz=1.0 / FRAME_S if tier == "T1" else None)
    place = Path(folder) / "data" / identity
    place.mkdir(parents=True, exist_ok=True)
    if tier == "T1":
        write_films(place, recording, stratum.noise, np.random.default_rng([seed, 1000]))
    else:
        for name, columns in sorted(recording.files.items()):
            write_columns(place / name, columns)
        if stratum.controlled:
            write_about(place, {"position_targets": recording.truth["position_targets"]})
    os.utime(place, (STAMP, STAMP))
    return answer(identity, stratum, recording, split) | {"tier": tier}


def plain(value: object) -> object:
    """A NumPy number or array as JSON holds it.

    Raises:
        TypeError: for anything else.
    """
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is not of JSON")


def make(
    split: str,
    key: str,
    n: int,
    out: Path,
    *,
    systems: str,
    jobs: int,
    tier: str = "T0",
    only_outside: bool = False,
) -> list[dict[str, Any]]:
    """Make a split, or what is outside the catalogue in it, and return its answers by their names."""
    secret = key.encode()
    names = identities(secret, split, n)
    tasks: list[Task] = [
        (name, stratum, seed_of(secret, name), split, str(out), tier)
        for name, stratum in zip(names, strata(secret, split, n, systems), strict=True)
        if not only_outside or reported(stratum.label[0], stratum) == "unknown"
    ]
    tasks.sort(key=lambda task: task[0])
    out.mkdir(parents=True, exist_ok=True)
    answers = []
    began = time.perf_counter()
    with Pool(jobs) as pool:
        for k, item in enumerate(pool.imap(make_one, tasks)):
            answers.append(item)
            if (k + 1) % 10 == 0 or k + 1 == len(tasks):
                spent_s = time.perf_counter() - began
                print(f"{k + 1}/{len(tasks)} recordings, {spent_s:.0f} s", file=sys.stderr)
    text = "".join(json.dumps(item, default=plain) + "\n" for item in answers)
    (out / "answers.jsonl").write_text(text, encoding="utf-8")
    return answers


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--split", required=True, help="name of the split, as dev or blind-1")
    parser.add_argument("--key", required=True, help="secret of every seed, or @PATH of its file")
    parser.add_argument("--n", type=int, required=True, help="number of recordings")
    parser.add_argument("--out", type=Path, required=True, help="folder to write")
    parser.add_argument("--tier", choices=("T0", "T1"), default="T0", help="trajectories or films")
    parser.add_argument("--systems", choices=sorted(SYSTEMS), default="all", help="group of mechanisms")
    parser.add_argument(
        "--only-outside", action="store_true", help="recordings with effects of no catalogue entry alone"
    )
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    args = parser.parse_args(argv)
    if args.tier == "T1" and args.systems in WIDE:
        parser.error(
            f"--systems {args.systems} has no films: only mechanisms of the other groups can be drawn"
        )
    make(
        *(args.split, read_key(args.key), args.n, args.out),
        systems=args.systems,
        jobs=args.jobs,
        tier=args.tier,
        only_outside=args.only_outside,
    )


if __name__ == "__main__":
    main()
