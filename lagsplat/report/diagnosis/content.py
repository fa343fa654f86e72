"""What a report shows of a diagnosis, computed or read back: images, checks of the data, place, rollouts.

`ReportContent` holds what stands beside the diagnosis. The functions read its loosely typed parts, ``checks``
and ``where``, of which any may be missing, and write the held-out forecasts to ``rollouts.csv``.
"""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float64, UInt8

from lagsplat.diagnose.core.result import LEVELS, Block, Diagnosis, Gap, Interval
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.diagnose.inference.profile_likelihood import ProfileLikelihood, Separability
from lagsplat.diagnose.residual.correlations import ResidualCorrelations
from lagsplat.io.files.atomic import replace_atomically
from lagsplat.report.common.formatting import format_interval, format_number

SEPARATE_CHECKS = ("findings", "excitation", "undetermined", "chain", "refit", "immaterial", "joints")
"""Checks that have a function of their own; `read_measures` gives the others."""
MAX_RECOMMENDED = 3  # recordings and experiments that are recommended at once [count]
ADVICE_FROM = 0.01  # probability of an effect from which a recording is recommended for it
EMPTY_WHERE: dict[str, Any] = {
    "level": None,
    "coordinates": {},
    "time_s": [],
    "frequency_hz": [],
    "state_region": {},
    "image_region": None,
}
"""Written of the place of a gap that was not located; ``not_computed`` lists its keys then."""
NEXT_INPUTS = "next_experiment_{}.csv"
FORECAST_KINDS = ("real", "sim", "augmented")


@dataclass(frozen=True)
class ImageErrorMap:
    """Excess error (H, W) of the sim's images over one frame; parts (left, top, right, bottom, share)."""

    frame: UInt8[np.ndarray, "H W 3"]
    excess: Float64[np.ndarray, "H W"]
    parts: tuple[tuple[int, int, int, int, float], ...] = ()


@dataclass(frozen=True)
class ImageForceMap:
    """How well a force on each point of the body explains the residual.

    ``points`` (P, 2) lie on ``frame`` (x to the right, y down, pixels). ``explained`` (P,) is the share that
    a force on each explains, and ``forces`` (P, 2) are the mean forces; ``near`` are the points next to the
    best. Where the force is not ``localisable`` none is drawn.
    """

    frame: UInt8[np.ndarray, "H W 3"]
    points: Float64[np.ndarray, "P 2"]
    explained: Float64[np.ndarray, " P"]
    forces: Float64[np.ndarray, "P 2"]
    near: tuple[int, ...]
    localisable: bool


@dataclass(frozen=True)
class VideoComparison:
    """Frames (T, H, W, 3) of one stretch: measured, forecast by the sim, and with the effects.

    They are shown ``slowed`` times slower than they were recorded.
    """

    real: UInt8[np.ndarray, "T H W 3"]
    sim: UInt8[np.ndarray, "T H W 3"]
    augmented: UInt8[np.ndarray, "T H W 3"]
    frames_per_s: float
    slowed: float = 1.0


@dataclass(frozen=True)
class ReportContent:
    """What a report shows beside the diagnosis itself; every part may be missing.

    ``stages`` of the error budget are as `lagsplat.diagnose.residual` computes them. ``command`` says how the
    diagnosis was made, ``stamp`` with which code and libraries.
    """

    stages: tuple[Any, ...] = ()
    separability: Separability | None = None
    profiles: tuple[ProfileLikelihood, ...] = ()
    correlations: ResidualCorrelations | None = None
    image_error: ImageErrorMap | None = None
    image_force: ImageForceMap | None = None
    video: VideoComparison | None = None
    command: str = ""
    stamp: Mapping[str, Any] = field(default_factory=dict)


def list_findings(diagnosis: Diagnosis) -> list[Mapping[str, Any]]:
    """List the fields of each `Finding` on the data, the gravest first; none where there were no checks."""
    severity = {level: number for number, level in enumerate(LEVELS)}
    findings = diagnosis.checks.get("findings", ())
    return sorted(findings, key=lambda finding: severity.get(finding["level"], len(severity)))


def list_excited(diagnosis: Diagnosis, grade: str) -> list[str]:
    """List the effects that the recording shows well ("yes"), weakly ("weak") or not at all ("no")."""
    rows = diagnosis.checks.get("excitation", ())
    return [row["effect"] for row in rows if row["excited"] == grade]


def recommend_recordings(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """Recommend what to record: what tells likely effects apart or, where none is missing, shows others.

    At most `MAX_RECOMMENDED` different recordings, each with the likeliest effect that it would show.
    """
    probabilities = {candidate.name: candidate.probability for candidate in diagnosis.candidates}
    if diagnosis.verdict == "none":
        rows = [text.partition(": ")[::2] for text in diagnosis.excitation]
    else:
        likely = (name for name, probability in probabilities.items() if probability >= ADVICE_FROM)
        rows = [(name, catalogue()[name].needs) for name in likely if name in catalogue()]
    open_effects = [(name, record) for name, record in rows if record and name not in diagnosis.combination]
    distinct: dict[str, str] = {}
    for name, record in sorted(open_effects, key=lambda row: -probabilities.get(row[0], 0.0)):
        distinct.setdefault(record, name)
    return [(name, record) for record, name in distinct.items()][:MAX_RECOMMENDED]


def compute_remaining(gap: Gap | None, closure: Interval | None) -> Interval:
    """Compute the error that forecasts keep [rms of each coordinate] from the share of the gap closed.

    It is on the scale of the errors of ``gap``, and never negative; None where the share or its floor is not
    known.
    """
    if gap is None or closure is None or not math.isfinite(gap.floor):
        return Interval(None, None, None)
    removable = gap.before - gap.floor
    value, high, low = (
        None if share is None else max(gap.before - share * removable, 0.0)
        for share in (closure.value, closure.low, closure.high)
    )
    return Interval(value, low, high)


def list_refit_moves(diagnosis: Diagnosis) -> list[tuple[str, str, str, str]]:
    """List how a refit alone moves the sim's own numbers: name with its unit, change, interval, tolerance."""
    rows = []
    for move in diagnosis.checks.get("refit", ()):
        value, low, high = format_interval(move["value"], move["low"], move["high"])
        tolerance = format_number(move["tolerance"], digits=2)
        rows.append((f"{move['name']} ({move['unit']})", value, f"{low} to {high}", f"± {tolerance}"))
    return rows


def list_joints(diagnosis: Diagnosis) -> list[Mapping[str, Any]]:
    """List the rows of joints that were diagnosed one by one, as `summarize_joint` makes them."""
    return list(diagnosis.checks.get("joints", ()))


def read_measures(diagnosis: Diagnosis) -> dict[str, Any]:
    """Read the other checks as plain values by name."""
    checks = diagnosis.checks.items()
    return {str(name): to_plain_data(value) for name, value in checks if name not in SEPARATE_CHECKS}


def read_location(diagnosis: Diagnosis) -> Mapping[str, Any]:
    """Read where the gap lies, an object or a mapping, as a mapping; empty where it was not located."""
    where = diagnosis.where
    return where if isinstance(where, Mapping) else {} if where is None else vars(where)


def list_missing_fields(diagnosis: Diagnosis) -> list[str]:
    """List what was not located; an image region of None only says that there are no images."""
    location = read_location(diagnosis)
    if "not_computed" in location:
        return list(location["not_computed"])
    known = {name for name, value in location.items() if value is not None or name == "image_region"}
    return [name for name in (*EMPTY_WHERE, "components") if name not in known]


def find_main_coordinate(diagnosis: Diagnosis) -> str | None:
    """Find the coordinate with the largest share of the residual; None where none has any."""
    shares = read_location(diagnosis).get("coordinates") or {}
    if not shares or max(shares.values()) <= 0.0:
        return None
    return str(max(shares, key=lambda name: shares[name]))


def build_rollouts_table(blocks: Sequence[Block], *, q_names: Sequence[str] = ()) -> pd.DataFrame:
    """Build the table of all held-out blocks, measured and forecast twice, so that anybody can score them.

    Its columns are ``file, block, t``, then every coordinate as measured, of the sim and of the sim with
    effects. ``t`` is the recording's own clock [s]. Names default to ``q0, q1, ...``.

    Raises:
        ValueError: blocks or names of different numbers of coordinates.
    """
    widths = {block.real.shape[1] for block in blocks} | ({len(q_names)} if q_names else set())
    if len(widths) > 1:
        raise ValueError(f"rollouts of {sorted(widths)} coordinates; all blocks and names must have as many")
    names = tuple(q_names) or tuple(f"q{i}" for i in range(max(widths, default=1)))
    columns = [f"{name}_{kind}" for kind in FORECAST_KINDS for name in names]
    parts = []
    for block in blocks:
        motions = np.concatenate([getattr(block, kind) for kind in FORECAST_KINDS], axis=1)
        place = pd.DataFrame({"file": block.file, "block": block.index, "t": block.time_s})
        parts.append(place.join(pd.DataFrame(motions, columns=columns)))
    empty = pd.DataFrame(columns=["file", "block", "t", *columns])
    return pd.concat(parts, ignore_index=True) if parts else empty


def save_rollouts(
    path: str | os.PathLike[str], blocks: Sequence[Block], *, q_names: Sequence[str] = ()
) -> None:
    """Write `build_rollouts_table` in full precision, whole or not at all."""
    table = build_rollouts_table(blocks, q_names=q_names)
    with replace_atomically(path) as temporary:
        table.to_csv(temporary, index=False)


def save_next_inputs(folder: str | os.PathLike[str], diagnosis: Diagnosis) -> None:
    """Write the inputs of each suggested experiment to ``next_experiment_1.csv`` and so on, in its order.

    Older such files go. A mechanism without inputs gets none: its start stands in the suggestion.
    """
    for old in Path(folder).glob(NEXT_INPUTS.format("[0-9]")):
        old.unlink()
    planned = diagnosis.next_experiments
    for number, each in enumerate(planned.suggestions if planned else (), start=1):
        if len(each.input) > 1:
            with replace_atomically(Path(folder) / NEXT_INPUTS.format(number)) as temporary:
                pd.DataFrame(each.input).to_csv(temporary, index=False)


def to_plain_data(value: Any) -> Any:
    """Convert to what JSON can hold: dictionaries and lists, with None in the place of infinity and NaN.

    Raises:
        TypeError: something that has no such form.
    """
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: to_plain_data(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): to_plain_data(element) for key, element in value.items()}
    if isinstance(value, set | frozenset):
        value = sorted(value)
    if isinstance(value, list | tuple):
        return [to_plain_data(element) for element in value]
    raise TypeError(f"a {type(value).__name__} has no place in JSON; give numbers, texts, lists or mappings")
