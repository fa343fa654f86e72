"""Recordings that are diagnosed one after another, nobody being there to read a report of each."""

import json
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from lagsplat.diagnose.config import DiagnoseConfig
from lagsplat.gap import examine
from lagsplat.io.atomic import write_text
from lagsplat.io.checksum import sha256_of
from lagsplat.io.plain import save_json
from lagsplat.pair import open_pair
from lagsplat.provenance import stamp
from lagsplat.report.diagnosis_json import save_diagnosis
from lagsplat.report.diagnosis_rollouts import save_rollouts

log = logging.getLogger(__name__)
SIM, REAL = "sim_*.csv", "real_*.csv"


@dataclass(frozen=True)
class Run:
    """A recording and the effects that are left out of the catalogue for it."""

    place: Path
    without: tuple[str, ...]


def batch_of(folder: Path, number: int, size: int) -> list[Path]:
    """The recordings of batch ``number`` (from 0) of a folder that holds one folder a recording, by name."""
    places = sorted(path for path in folder.iterdir() if path.is_dir())
    return places[number * size : (number + 1) * size]


def runs_of(listed: Path, folders: Sequence[Path], number: int, size: int) -> list[Run]:
    """Batch ``number`` (from 0) of the runs ``listed`` one a line as ``{"id": ..., "without": [...]}``.

    ``folders`` hold one folder a recording.
    """
    places = {place.name: place for folder in folders for place in folder.iterdir()}
    lines = listed.read_text(encoding="utf-8").splitlines()[number * size : (number + 1) * size]
    runs = [json.loads(line) for line in lines]
    return [Run(places[run["id"]], tuple(run["without"])) for run in runs]


def sign(out: Path, seal: Path, header: Mapping[str, Any]) -> None:
    """Write beside predictions who made them, from which code and under which seal: ``made_by.json``."""
    save_json(out / "made_by.json", {**header, **stamp(), "seal": sha256_of(seal)})


def predict(place: Path, out: Path, config: DiagnoseConfig, *, without: Sequence[str] = ()) -> bool:
    """Write ``diagnosis.json`` and ``rollouts.csv`` of the recording in ``place`` to ``out``, see `each`.

    Its sim is ``sim_*.csv`` and its real side ``real_*.csv``; effects named ``without`` are left out of the
    catalogue.
    """
    chosen = replace(config, without=[*config.without, *without])
    return each(place, out, lambda place, out: _diagnose(place, out, chosen))


def each(place: Path, out: Path, work: Callable[[Path, Path], None]) -> bool:
    """Do ``work`` on the recording in ``place``, into ``out``.

    A recording that is refused, or at which the work fails, must not end the others: the reason then stands
    in ``out/failed.txt`` and in the log, and the answer is False.
    """
    out.mkdir(parents=True, exist_ok=True)
    try:
        work(place, out)
    except Exception as error:
        log.exception("nothing comes of %s", place.name)
        write_text(out / "failed.txt", f"{type(error).__name__}: {error}\n")
        return False
    return True


def _diagnose(place: Path, out: Path, config: DiagnoseConfig) -> None:
    pair = open_pair(str(place / SIM), str(place / REAL), config)
    found = examine(pair, config, tell=lambda name: None).diagnosis
    if found.blocks:
        save_rollouts(out / "rollouts.csv", found.blocks, q_names=found.q_names)
    save_diagnosis(out / "diagnosis.json", found)
