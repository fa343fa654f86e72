"""What a report shows of a diagnosis, computed or read back: images, checks of the data, place, rollouts.

`ReportContent` holds what stands beside the diagnosis. The functions read its loosely typed parts, ``checks``
and ``where``, of which any may be missing, and write the held-out forecasts to ``rollouts.csv``.
"""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float64, UInt8

from lagsplat.diagnose.core.result import Block, Diagnosis
from lagsplat.diagnose.inference.profile_likelihood import ProfileLikelihood, Separability
from lagsplat.diagnose.residual.components import ResidualCorrelations
from lagsplat.io.files.atomic import replace_atomically
from lagsplat.report.common.formatting import format_percent

SEPARATE_CHECKS = ("findings", "excitation", "undetermined", "chain")
"""Checks that have a function of their own; `read_measures` gives the others."""
SEVERITY = {"refuse": 0, "undetermined": 1, "warn": 2}
REQUIRED_FIELDS = ("level", "coordinates", "time_s", "frequency_hz", "state_region", "image_region")
"""Fields of ``where`` in every `diagnosis.json`."""
OPTIONAL_FIELDS = ("components", "memory_index", "evidence")
MIN_EVENT_SHARE = 0.5  # share of the residual from which the summary mentions a short event
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

    ``stages`` of the error budget and ``maps_after`` are as `lagsplat.diagnose.residual` computes them;
    ``steps`` (label, gap) lie between the refit sim and the last effect. ``command`` and ``digests`` say how
    the diagnosis was made, ``stamp`` with which code and libraries.
    """

    stages: tuple[Any, ...] = ()
    steps: tuple[tuple[str, float], ...] = ()
    maps_after: tuple[Any, ...] = ()
    separability: Separability | None = None
    profiles: tuple[ProfileLikelihood, ...] = ()
    correlations: ResidualCorrelations | None = None
    image_error: ImageErrorMap | None = None
    image_force: ImageForceMap | None = None
    video: VideoComparison | None = None
    command: str = ""
    digests: Mapping[str, str] = field(default_factory=dict)
    stamp: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class DataFinding:
    """One finding of the checks of the data: its ``level``, the file it concerns, and three sentences."""

    level: str
    source: str
    what: str
    why: str
    remedy: str


@dataclass(frozen=True)
class EffectExcitation:
    """Whether a recording can show one effect ("yes", "weak" or "no"), why, and what to record instead."""

    effect: str
    excited: str
    reason: str
    record: str


def read_findings(diagnosis: Diagnosis) -> list[DataFinding]:
    """Read the findings in ``checks["findings"]``, the gravest first; none where there were no checks."""
    rows = [_read_fields(row) for row in diagnosis.checks.get("findings") or ()]
    names = ("level", "source", "what", "why", "remedy")
    findings = [DataFinding(*(str(row.get(name) or "") for name in names)) for row in rows]
    return sorted(findings, key=lambda finding: SEVERITY.get(finding.level, len(SEVERITY)))


def read_excitations(diagnosis: Diagnosis) -> list[EffectExcitation]:
    """Read from ``checks["excitation"]`` which effects the recording can show; none where not computed."""
    rows = [_read_fields(row) for row in diagnosis.checks.get("excitation") or ()]
    names = ("effect", "excited", "reason", "record")
    return [EffectExcitation(*(str(row.get(name) or "") for name in names)) for row in rows]


def select_effects(rows: Sequence[EffectExcitation], grade: str) -> list[str]:
    """Select the names of the effects of one grade."""
    return [row.effect for row in rows if row.excited == grade]


def recommend_recordings(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """Recommend what to record for each effect that this recording shows badly, the likeliest first."""
    rows = [text.partition(": ")[::2] for text in diagnosis.excitation]
    probabilities = {candidate.name: candidate.probability for candidate in diagnosis.candidates}
    open_effects = [(name, record) for name, record in rows if name not in diagnosis.combination]
    return sorted(open_effects, key=lambda row: -probabilities.get(row[0], 0.0))


def read_measures(diagnosis: Diagnosis) -> dict[str, Any]:
    """Read the other checks as plain values by name."""
    checks = diagnosis.checks.items()
    return {str(name): to_plain_data(value) for name, value in checks if name not in SEPARATE_CHECKS}


def explain_undecided(diagnosis: Diagnosis) -> list[str]:
    """Explain why nothing can be decided, the main reason first; one general sentence without a reason."""
    given = diagnosis.checks.get("undetermined") or ()
    reasons = [given] if isinstance(given, str) else [str(reason) for reason in given]
    findings = [finding for finding in read_findings(diagnosis) if finding.level == "undetermined"]
    reasons = reasons or [f"{finding.what}; {finding.why}" for finding in findings]
    general = "the candidates explain the recording about equally well"
    return reasons or list(diagnosis.warnings[:1]) or [general]


def _read_fields(row: Any) -> Mapping[str, Any]:
    fields_of_row = to_plain_data(row)
    if not isinstance(fields_of_row, Mapping):
        raise TypeError(f"a check must have named fields, but is {row!r}")
    return fields_of_row


def get_location(where: Any, name: str) -> Any:
    """Get one field of ``where``, an object or a mapping; None where it was not computed."""
    if isinstance(where, Mapping):
        return where.get(name)
    return getattr(where, name, None)


def list_missing_fields(where: Any) -> tuple[str, ...]:
    """List the fields that are missing; an image region of None only says that there are no images."""
    if isinstance(where, Mapping) and "not_computed" in where:
        return tuple(where["not_computed"])
    absent = object()

    def has(name: str) -> bool:
        value = where.get(name, absent) if isinstance(where, Mapping) else getattr(where, name, absent)
        return value is not absent and (value is not None or name == "image_region")

    return tuple(name for name in (*REQUIRED_FIELDS, "components") if not has(name))


def find_main_coordinate(where: Any) -> str | None:
    """Find the coordinate with the largest share of the residual; None where none has any."""
    shares = get_location(where, "coordinates") or {}
    if not shares or max(shares.values()) <= 0.0:
        return None
    return str(max(shares, key=lambda name: shares[name]))


def describe_event(where: Any, period_s: float) -> str:
    """Describe when most of the residual acts, if that is within a natural period [s]; else empty."""
    events = get_location(where, "time_s") or ()
    if not events:
        return ""
    file, start_s, end_s, share = events[0]
    if share < MIN_EVENT_SHARE or not end_s - start_s < period_s:
        return ""
    percent = format_percent(share)
    return f" {percent} of what is missing acts between {start_s:.4g} and {end_s:.4g} s of {file}."


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
    columns = ["file", "block", "t", *(f"{name}_{kind}" for kind in FORECAST_KINDS for name in names)]
    parts = []
    for block in blocks:
        paths = np.concatenate([getattr(block, kind) for kind in FORECAST_KINDS], axis=1)
        part = pd.DataFrame(paths, columns=columns[3:])
        part.insert(0, "t", block.time_s)
        part.insert(0, "block", block.index)
        part.insert(0, "file", block.file)
        parts.append(part)
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=columns)


def save_rollouts(
    path: str | os.PathLike[str], blocks: Sequence[Block], *, q_names: Sequence[str] = ()
) -> None:
    """Write `build_rollouts_table` in full precision, whole or not at all."""
    table = build_rollouts_table(blocks, q_names=q_names)
    with replace_atomically(path) as temporary:
        table.to_csv(temporary, index=False)


def load_rollouts(path: str | os.PathLike[str]) -> tuple[tuple[Block, ...], tuple[str, ...]]:
    """Load the blocks of a file and the names of their coordinates.

    Raises:
        ValueError: the columns are not those of rollouts.
    """
    table = pd.read_csv(path, dtype={"file": str})
    names = tuple(str(name).removesuffix("_real") for name in table.columns if str(name).endswith("_real"))
    wanted = ["file", "block", "t", *(f"{name}_{kind}" for kind in FORECAST_KINDS for name in names)]
    if list(table.columns) != wanted or not names:
        raise ValueError(
            f"{os.fspath(path)} has columns {list(table.columns)}; rollouts have "
            "file, block, t, then q*_real, q*_sim and q*_augmented of the same coordinates"
        )
    blocks = []
    for (file, index), part in table.groupby(["file", "block"], sort=False):
        real, sim, augmented = (
            part[[f"{name}_{kind}" for name in names]].to_numpy(dtype=np.float64) for kind in FORECAST_KINDS
        )
        time_s = part["t"].to_numpy(dtype=np.float64)
        blocks.append(Block(str(file), int(str(index)), time_s, real, sim, augmented))
    return tuple(blocks), names


def to_plain_data(value: Any) -> Any:
    """Convert to what JSON can hold: dictionaries and lists, with None in the place of infinity and NaN.

    Raises:
        TypeError: something that has no such form.
    """
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, np.generic):
        return to_plain_data(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if is_dataclass(value) and not isinstance(value, type):
        return {field.name: to_plain_data(getattr(value, field.name)) for field in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): to_plain_data(element) for key, element in value.items()}
    if isinstance(value, set | frozenset):
        return [to_plain_data(element) for element in sorted(value)]
    if isinstance(value, list | tuple):
        return [to_plain_data(element) for element in value]
    if isinstance(value, np.ndarray):
        return to_plain_data(value.tolist())
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    raise TypeError(f"a {type(value).__name__} has no place in JSON; give numbers, texts, lists or mappings")
