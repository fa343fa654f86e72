"""Predictions of a diagnosis as the score takes them, one folder a recording."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
BURN = 10


@dataclass(frozen=True)
class Prediction:
    """What was said about one recording.

    ``verdict`` is ``missing`` where nothing was said. ``ranking`` holds names from the most probable down,
    the verdicts ``none`` and ``unknown`` first where they were given. ``gaps`` are (before, after)
    recomputed from the rollouts as fractions of the given rms, or None without rollouts.
    """

    verdict: str
    probability: dict[str, float]
    ranking: tuple[str, ...]
    combination: tuple[str, ...]
    candidates: dict[str, dict[str, Any]]
    where: dict[str, Any]
    claimed: dict[str, Any]
    gaps: tuple[float, float] | None


def read_prediction(folder: Path, rms: list[float]) -> Prediction:
    """The prediction in a folder of ``diagnosis.json`` and ``rollouts.csv``; ``missing`` without the first.

    Raises:
        ValueError: if probabilities are negative or do not sum to one.
    """
    path = folder / "diagnosis.json"
    if not path.is_file():
        return Prediction("missing", {}, (), (), {}, {}, {}, None)
    said = json.loads(path.read_text(encoding="utf-8"))
    probability: dict[str, float] = {}
    candidates: dict[str, dict[str, Any]] = {}
    for entry in said["effects"]:
        name, p = entry["name"], float(entry["probability"])
        probability[name] = probability.get(name, 0.0) + p
        if name not in candidates or p > float(candidates[name]["probability"]):
            candidates[name] = entry
    total = sum(probability.values())
    if min(probability.values(), default=0.0) < 0.0 or abs(total - 1.0) > 1e-3:
        raise ValueError(f"{path}: probabilities sum to {total:.4f}; they must be shares of one")
    ranking = sorted(probability, key=lambda name: -probability[name])
    if said["verdict"] in ("none", "unknown"):
        ranking = [said["verdict"], *(name for name in ranking if name != said["verdict"])]
    return Prediction(
        said["verdict"],
        probability,
        tuple(ranking),
        tuple(said.get("combination", ())) if said["verdict"] == "effect" else (),
        candidates,
        said.get("where") or {},
        said.get("gap") or {},
        recomputed_gaps(folder / "rollouts.csv", rms),
    )


def recomputed_gaps(path: Path, rms: list[float]) -> tuple[float, float] | None:
    """RMS of real minus sim and of real minus augmented over every block past its first ten samples, or None.

    Both are fractions of each coordinate's ``rms`` (d,) in the units of the answers, or of the rollouts'
    own where their number of coordinates is another.
    """
    if not path.is_file():
        return None
    with path.open(encoding="utf-8") as lines:
        names = lines.readline().strip().split(",")
    coordinates = [name.removesuffix("_real") for name in names if name.endswith("_real")]
    if not coordinates:
        return None
    wanted = [names.index(f"{q}_{kind}") for kind in ("real", "sim", "augmented") for q in coordinates]
    block = names.index("block")
    keys = [names.index("file"), block] if "file" in names else [block]
    text = np.loadtxt(path, delimiter=",", skiprows=1, dtype=str, ndmin=2, comments=None)
    if not len(text):
        return None
    values = text[:, wanted].astype(float)
    label = np.array(["|".join(row) for row in text[:, keys]])
    first = np.r_[True, label[1:] != label[:-1]]
    start = np.maximum.accumulate(np.where(first, np.arange(len(label)), 0))
    values = values[np.arange(len(label)) - start >= BURN]
    if not len(values):
        return None
    d = len(coordinates)
    real, sim, augmented = values[:, :d], values[:, d : 2 * d], values[:, 2 * d :]
    scale = np.array(rms) if len(rms) == d else np.sqrt((real**2).mean(0))
    before = np.sqrt((((real - sim) / scale) ** 2).mean())
    after = np.sqrt((((real - augmented) / scale) ** 2).mean())
    return float(before), float(after)
