"""Diagnose many recordings one after another; encode videos with an autoencoder of the nominal ones.

Source: the paper's stage 1; real videos never enter a fit.
"""

import json
import logging
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from lagsplat.chart.chart import require_trained_autoencoder
from lagsplat.chart.config import ChartConfig
from lagsplat.chart.visibility import fit_whitening
from lagsplat.diagnose.core.config import DiagnoseConfig
from lagsplat.io.files.atomic import load_json, save_csv, save_json, sha256_of, write_text
from lagsplat.io.krauss import read_krauss_npz
from lagsplat.io.recording.recording import Recording
from lagsplat.pipelines.diagnosis import run_diagnosis
from lagsplat.pipelines.diagnosis_inputs import open_diagnosis_inputs
from lagsplat.provenance import stamp
from lagsplat.report.diagnosis.content import save_rollouts
from lagsplat.report.diagnosis.serialization import save_diagnosis
from lagsplat.stage1.autoencoder import encode_frames
from lagsplat.stage1.config import Stage1Config
from lagsplat.stage1.fit import fit_autoencoder
from lagsplat.stage1.linear_response import InputHistory

log = logging.getLogger(__name__)


def list_batch(folder: Path, number: int, size: int) -> list[Path]:
    """Folders of batch ``number`` (from 0) with ``size`` recordings each, in the order of their names."""
    places = sorted(path for path in folder.iterdir() if path.is_dir())
    return places[number * size : (number + 1) * size]


def read_batch(listed: Path, folders: Sequence[Path], number: int, size: int) -> dict[Path, list[str]]:
    """Read batch ``number`` (from 0) of a list with one ``{"id": ..., "without": [...]}`` a line.

    Returns the effects that are left out of the catalogue for each recording, by its folder.
    """
    places = {place.name: place for folder in folders for place in folder.iterdir()}
    lines = listed.read_text(encoding="utf-8").splitlines()[number * size : (number + 1) * size]
    items = [json.loads(line) for line in lines]
    return {places[item["id"]]: item["without"] for item in items}


def write_provenance(out: Path, seal: Path, header: Mapping[str, Any]) -> None:
    """Write ``made_by.json`` beside predictions: who made them, from which code and under which seal."""
    save_json(out / "made_by.json", {**header, **stamp(), "seal": sha256_of(seal)})


def predict_recording(place: Path, out: Path, config: DiagnoseConfig, *, without: Sequence[str] = ()) -> bool:
    """Diagnose ``sim_*.csv`` against ``real_*.csv`` in ``place``; False where that fails, see `attempt`.

    ``diagnosis.json`` and ``rollouts.csv`` go to ``out``. Effects named ``without`` are left out of the
    catalogue.
    """
    config = replace(config, without=[*config.without, *without])

    def write_diagnosis(place: Path, out: Path) -> None:
        inputs = open_diagnosis_inputs(str(place / "sim_*.csv"), str(place / "real_*.csv"), config)
        diagnosis = run_diagnosis(inputs, config, report_progress=lambda name: None).diagnosis
        if diagnosis.blocks:
            save_rollouts(out / "rollouts.csv", diagnosis.blocks, q_names=diagnosis.q_names)
        save_diagnosis(out / "diagnosis.json", diagnosis)

    return attempt(place, out, write_diagnosis)


def attempt(place: Path, out: Path, work: Callable[[Path, Path], None]) -> bool:
    """Run ``work`` on the recording in ``place``, with results in ``out``; False where it raises.

    A failure must not end the other recordings: its reason is logged and written to ``out/failed.txt``.
    """
    out.mkdir(parents=True, exist_ok=True)
    try:
        work(place, out)
    except Exception as error:
        log.exception("%s failed", place.name)
        write_text(out / "failed.txt", f"{type(error).__name__}: {error}\n")
        return False
    return True


def encode_videos(place: Path, out: Path, stage1: Stage1Config, chart: ChartConfig) -> None:
    """Encode a folder of videos into whitened latents, ``sim_0.csv`` and ``real_0.csv``; each is one clip.

    The folder ``place`` holds ``sim_*.npz``, ``real_*.npz`` and ``about.json``, which has the number of
    ``coordinates`` and the time between frames, ``frame_s`` [s]. The autoencoder is fitted to the nominal
    videos alone, and so is the whitening.

    Raises:
        FileNotFoundError: a video is missing.
        ValueError: a video is damaged, or stage 1 learned nothing.
    """
    about = load_json(place / "about.json")
    sides = {name: _read_videos(place, name, float(about["frame_s"])) for name in ("sim", "real")}
    frames = np.concatenate([film.frames for film in sides["sim"]])
    inputs = np.concatenate([film.inputs for film in sides["sim"]])
    ends = np.cumsum([film.n_frames for film in sides["sim"]]).tolist()
    history = InputHistory(inputs, tuple(pairwise([0, *ends])))
    settings = replace(stage1, d=int(about["coordinates"]))
    autoencoder, _ = fit_autoencoder(frames, settings, seed=0, history=history)
    require_trained_autoencoder(autoencoder, frames)
    raw = {side: [encode_frames(autoencoder, film.frames) for film in films] for side, films in sides.items()}
    white = fit_whitening(np.concatenate(raw["sim"]), eigenvalue_floor=chart.eigenvalue_floor)
    out.mkdir(parents=True, exist_ok=True)
    for side, films in sides.items():
        latents = [(z - white.mean) @ white.whiten for z in raw[side]]
        save_csv(out / f"{side}_0.csv", _latent_rows(films, latents))


def _read_videos(place: Path, name: str, frame_s: float) -> list[Recording]:
    """The sim or the real videos in the order of their numbers."""
    paths = sorted(place.glob(f"{name}_*.npz"), key=lambda path: int(path.stem.rpartition("_")[2]))
    if not paths:
        raise FileNotFoundError(f"{place} has no {name}_*.npz; a recording needs sim and real videos")
    films = []
    for path in paths:
        with zipfile.ZipFile(path) as archive:
            inputs = sum(member.removesuffix(".npy")[1:].isdigit() for member in archive.namelist())
        films.append(read_krauss_npz(path, dt_s=frame_s, expected_inputs=inputs))
    return films


def _latent_rows(films: Sequence[Recording], latents: Sequence[np.ndarray]) -> list[dict[str, float | int]]:
    """One row a frame; each video is a clip, and begins two frames after the end of the last one."""
    rows: list[dict[str, float | int]] = []
    begun = 0.0
    for number, (film, q) in enumerate(zip(films, latents, strict=True)):
        for t, state, inputs in zip(film.time_s, q, film.inputs, strict=True):
            states = {f"q{i}": float(value) for i, value in enumerate(state)}
            forcing = {f"u{i}": float(value) for i, value in enumerate(inputs)}
            rows.append({"t": begun + float(t), **states, **forcing, "segment": number})
        begun = float(rows[-1]["t"]) + 2.0 * film.dt_s
    return rows
