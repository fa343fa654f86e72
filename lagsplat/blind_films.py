"""Films of recordings nobody looks at: an autoencoder of the nominal ones, frozen, and what it sees in all.

Source: the paper's stage 1; the real films never enter a fit.
"""

import zipfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from lagsplat.chart.config import ChartConfig
from lagsplat.chart.trained import require_trained
from lagsplat.chart.whitening import fit_whitening
from lagsplat.io.krauss import read_krauss_npz
from lagsplat.io.plain import load_json, save_csv
from lagsplat.io.recording import Recording
from lagsplat.stage1.autoencoder import encode_frames
from lagsplat.stage1.config import Stage1Config
from lagsplat.stage1.fit import fit_autoencoder


def encode(place: Path, out: Path, stage1: Stage1Config, chart: ChartConfig) -> None:
    """Write ``sim_0.csv`` and ``real_0.csv`` in whitened latents, one clip a film, for a folder of films.

    ``place`` holds ``sim_*.npz``, ``real_*.npz`` and ``about.json`` with the number of ``coordinates`` and
    the seconds between frames, ``frame_s``. Both sides are whitened by the nominal one.

    Raises:
        FileNotFoundError, ValueError: a film is missing or damaged, or stage 1 learned nothing.
    """
    about = load_json(place / "about.json")
    sides = {name: _films(place, name, float(about["frame_s"])) for name in ("sim", "real")}
    frames = np.concatenate([film.frames for film in sides["sim"]])
    autoencoder, _ = fit_autoencoder(frames, replace(stage1, d=int(about["coordinates"])), seed=0)
    require_trained(autoencoder, frames)
    seen = {
        name: [encode_frames(autoencoder, film.frames) for film in films] for name, films in sides.items()
    }
    white = fit_whitening(np.concatenate(seen["sim"]), eigenvalue_floor=chart.eigenvalue_floor)
    out.mkdir(parents=True, exist_ok=True)
    for name, films in sides.items():
        latents = [(z - white.mean) @ white.whiten for z in seen[name]]
        save_csv(out / f"{name}_0.csv", _rows(films, latents))


def _films(place: Path, name: str, frame_s: float) -> list[Recording]:
    """The films of one side in the order of their numbers."""
    paths = sorted(place.glob(f"{name}_*.npz"), key=lambda path: int(path.stem.rpartition("_")[2]))
    if not paths:
        raise FileNotFoundError(f"{place}: no {name}_*.npz there; a recording needs films of both sides")
    out = []
    for path in paths:
        with zipfile.ZipFile(path) as archive:
            inputs = sum(member.removesuffix(".npy")[1:].isdigit() for member in archive.namelist())
        out.append(read_krauss_npz(path, dt_s=frame_s, expected_inputs=inputs))
    return out


def _rows(films: Sequence[Recording], latents: Sequence[np.ndarray]) -> list[dict[str, float | int]]:
    """One row a frame; each film is a clip, and begins two frames after the last one's end."""
    rows: list[dict[str, float | int]] = []
    begun = 0.0
    for number, (film, q) in enumerate(zip(films, latents, strict=True)):
        for t, state, inputs in zip(film.time_s, q, film.inputs, strict=True):
            row: dict[str, float | int] = {"t": begun + float(t)}
            row |= {f"q{i}": float(value) for i, value in enumerate(state)}
            row |= {f"u{j}": float(value) for j, value in enumerate(inputs)}
            rows.append(row | {"segment": number})
        begun = float(rows[-1]["t"]) + 2.0 * film.dt_s
    return rows
