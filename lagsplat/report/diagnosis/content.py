"""What a report of a diagnosis may show beside the diagnosis itself; every part may be missing.

What was known of a recording before anything was fitted, read from the checks of a diagnosis.

What is known of where a gap lies, whichever parts of it were computed or read back.

``rollouts.csv``: every held-out block, measured and forecast twice, so that anybody can score it again.
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
from lagsplat.diagnose.inference.identifiability import Separability
from lagsplat.diagnose.inference.profile_likelihood import ProfileLikelihood
from lagsplat.diagnose.residual.components import ResidualCorrelations
from lagsplat.io.files.atomic import replace_atomically
from lagsplat.report.common.formatting import format_percent


@dataclass(frozen=True)
class ImageErrorMap:
    """Excess error (H, W) of the sim's pictures over one; parts (left, top, right, bottom, share)."""

    picture: UInt8[np.ndarray, "H W 3"]
    excess: Float64[np.ndarray, "H W"]
    parts: tuple[tuple[int, int, int, int, float], ...] = ()


@dataclass(frozen=True)
class ImageForceMap:
    """Points (P, 2) of the body on one ``picture`` (x to the right, y down, pixels): the share ``explained``
    (P,) by a force on each, and mean forces (P, 2) of those ``near`` the best; no force where not
    ``localisable``."""

    picture: UInt8[np.ndarray, "H W 3"]
    points: Float64[np.ndarray, "P 2"]
    explained: Float64[np.ndarray, " P"]
    forces: Float64[np.ndarray, "P 2"]
    near: tuple[int, ...]
    localisable: bool


@dataclass(frozen=True)
class VideoComparison:
    """Pictures (T, H, W, 3) of one stretch: measured, forecast by the sim, and with the effects; shown
    ``slowed`` times slower than they were filmed."""

    real: UInt8[np.ndarray, "T H W 3"]
    sim: UInt8[np.ndarray, "T H W 3"]
    augmented: UInt8[np.ndarray, "T H W 3"]
    frames_per_s: float
    slowed: float = 1.0


@dataclass(frozen=True)
class ReportContent:
    """``rungs`` of the ladder and ``maps_after`` are as `lagsplat.diagnose` computes them (`Rung`, `Map`);
    ``steps`` (label, gap) lie between the refit sim and the last effect; ``command`` and ``digests`` say how
    the diagnosis was made, ``stamp`` with what."""

    rungs: tuple[Any, ...] = ()
    steps: tuple[tuple[str, float], ...] = ()
    maps_after: tuple[Any, ...] = ()
    separability: Separability | None = None
    profiles: tuple[ProfileLikelihood, ...] = ()
    fingerprint: ResidualCorrelations | None = None
    picture: ImageErrorMap | None = None
    force: ImageForceMap | None = None
    film: VideoComparison | None = None
    command: str = ""
    digests: Mapping[str, str] = field(default_factory=dict)
    stamp: Mapping[str, Any] = field(default_factory=dict)


EXCITATION_GRADES = ("yes", "weak", "no")
SEPARATE_CHECKS = ("findings", "excitation", "undetermined", "chain")


@dataclass(frozen=True)
class DataFinding:
    """One finding of the data's checks: its ``level``, whose it is, and three sentences."""

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
    """The findings in ``checks["findings"]``, the gravest first; none where they were not made."""
    rows = [_fields(row) for row in diagnosis.checks.get("findings") or ()]
    names = ("level", "source", "what", "why", "remedy")
    found = [DataFinding(*(str(row.get(name) or "") for name in names)) for row in rows]
    order = {"refuse": 0, "undetermined": 1, "warn": 2}
    return sorted(found, key=lambda one: order.get(one.level, 3))


def read_excitations(diagnosis: Diagnosis) -> list[EffectExcitation]:
    """What the recording can show, family by family, from ``checks["excitation"]``; none where not made."""
    rows = [_fields(row) for row in diagnosis.checks.get("excitation") or ()]
    names = ("effect", "excited", "reason", "record")
    return [EffectExcitation(*(str(row.get(name) or "") for name in names)) for row in rows]


def select_effects(rows: Sequence[EffectExcitation], grade: str) -> list[str]:
    """Names of the effects of one grade."""
    return [row.effect for row in rows if row.excited == grade]


def recommend_recordings(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """What to record to see each effect that this recording shows badly, the likeliest of them first."""
    told = [text.partition(": ")[::2] for text in diagnosis.excitation]
    chance = {one.name: one.probability for one in diagnosis.candidates}
    named = [(name, record) for name, record in told if name not in diagnosis.combination]
    return sorted(named, key=lambda row: -chance.get(row[0], 0.0))


def read_measures(diagnosis: Diagnosis) -> dict[str, Any]:
    """The other checks as plain values by name."""
    return {
        str(name): to_plain_data(value) for name, value in diagnosis.checks.items() if name not in SEPARATE_CHECKS
    }  # fmt: skip


def explain_undecided(diagnosis: Diagnosis) -> list[str]:
    """Why nothing can be decided, most telling first; one general sentence where no reason was given."""
    told = diagnosis.checks.get("undetermined") or ()
    if isinstance(told, str):
        told = (told,)
    grave = [one for one in read_findings(diagnosis) if one.level == "undetermined"]
    found = [str(one) for one in told] or [f"{one.what}; {one.why}" for one in grave]
    return (
        found or list(diagnosis.warnings[:1]) or ["the candidates explain the recording about equally well"]
    )


def _fields(row: Any) -> Mapping[str, Any]:
    made = to_plain_data(row)
    if not isinstance(made, Mapping):
        raise TypeError(f"a check must have named fields, but is {row!r}")
    return made


REQUIRED_FIELDS = ("level", "coordinates", "time_s", "frequency_hz", "state_region", "image_region")
"""What every `diagnosis.json` holds."""
OPTIONAL_FIELDS = ("components", "memory_index", "evidence")
MIN_EVENT_SHARE = 0.5
"""Share of the residual from which on a short event is told of."""


def get_location(where: Any, name: str) -> Any:
    """One field of ``where``, an object or a mapping; None where it was not computed."""
    if isinstance(where, Mapping):
        return where.get(name)
    return getattr(where, name, None)


def list_missing_fields(where: Any) -> tuple[str, ...]:
    """The fields that are missing. An image region of None says that there are no pictures, and is not."""
    if isinstance(where, Mapping) and "not_computed" in where:
        return tuple(where["not_computed"])
    absent = object()

    def has(name: str) -> bool:
        value = where.get(name, absent) if isinstance(where, Mapping) else getattr(where, name, absent)
        return value is not absent and (value is not None or name == "image_region")

    return tuple(name for name in (*REQUIRED_FIELDS, "components") if not has(name))


def find_main_coordinate(where: Any) -> str | None:
    """The coordinate with the largest share of the residual; None where none has any."""
    shares = get_location(where, "coordinates") or {}
    if not shares or max(shares.values()) <= 0.0:
        return None
    return str(max(shares, key=lambda name: shares[name]))


def describe_event(where: Any, period_s: float) -> str:
    """When most of the residual acts, in a sentence, if that is within a natural period; else nothing."""
    events = get_location(where, "time_s") or ()
    if not events:
        return ""
    file, start_s, end_s, share = events[0]
    if share < MIN_EVENT_SHARE or not end_s - start_s < period_s:
        return ""
    return (
        f" {format_percent(share)} of what is missing acts between {start_s:.4g} and {end_s:.4g} s of {file}."
    )


FORECAST_KINDS = ("real", "sim", "augmented")


def build_rollouts_table(blocks: Sequence[Block], *, q_names: Sequence[str] = ()) -> pd.DataFrame:
    """Columns ``file, block, t``, then every coordinate as measured, of the sim and of the sim with effects.

    ``t`` is the recording's own clock [s]. Names default to ``q0, q1, ...``.

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
    """The blocks of a file and the names of their coordinates.

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
    """Dataclasses, mappings, sequences and arrays as dictionaries and lists; what is not finite as None.

    JSON knows neither infinity nor NaN, and readers other than Python's stumble over them.

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
        return {str(key): to_plain_data(one) for key, one in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [
            to_plain_data(one) for one in (sorted(value) if isinstance(value, set | frozenset) else value)
        ]
    if isinstance(value, np.ndarray):
        return to_plain_data(value.tolist())
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    raise TypeError(f"a {type(value).__name__} has no place in JSON; give numbers, texts, lists or mappings")
