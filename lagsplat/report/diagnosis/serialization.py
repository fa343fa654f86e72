"""``diagnosis.json``: its form, and a `Diagnosis` written to it and read back.

The form is the record classes below, against which `msgspec` checks a file.
"""

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct
from msgspec.structs import asdict

from lagsplat.diagnose.core.result import (
    SCHEMA,
    Candidate,
    Diagnosis,
    FileAgreement,
    Gap,
    Interval,
    NextExperiments,
    Parameter,
    Verdict,
)
from lagsplat.diagnose.effects.registry import VERDICTS, list_names
from lagsplat.io.files.atomic import write_text
from lagsplat.report.diagnosis.content import EMPTY_WHERE, list_missing_fields, read_location, to_plain_data

PROBABILITY_TOLERANCE = 1e-6  # largest distance of the sum of all probabilities from one
Number = int | float | None
NAN = float("nan")
NO_INTERVAL = Interval(None, None, None)
NO_GAP = Gap(NAN, NAN, NAN, NAN, NAN, NO_INTERVAL)
"""Written where there is no gap, so that readers find its keys all the same."""
OPTIONAL_WHERE = ("components", "evidence")


class ParameterRecord(Struct):
    """A parameter with its 90 % interval; lists where an effect happens several times."""

    value: Number | list[Number]
    low: Number | list[Number]
    high: Number | list[Number]
    unit: str


class EffectRecord(Struct, kw_only=True):
    """One candidate."""

    name: str
    probability: Annotated[float, Meta(ge=0.0, le=1.0 + PROBABILITY_TOLERANCE)]
    coordinate: str | None
    input: str | None
    places: tuple[str, ...] = ()
    parameters: dict[str, ParameterRecord]
    closure: Interval
    log_evidence: Number = None
    misfit: Number = None


class GapRecord(Struct, kw_only=True):
    """Root mean square of the held-out forecasts' errors; null where it was not computed."""

    before: Number
    refit: Number = None
    after: Number
    floor: Number
    horizon_s: Number
    unit: Literal["fraction of each coordinate's rms"]
    closure: Interval = NO_INTERVAL
    blocks: int = 0
    diverged: dict[str, int] = {}


class WhereRecord(Struct):
    """Where the gap lies."""

    level: Literal["perception", "chart", "actuation", "dynamics"] | None
    coordinates: dict[str, Number]
    time_s: list[tuple[str, Number, Number, Number]]
    frequency_hz: list[tuple[Number, Number, Number]]
    state_region: dict[str, Any]
    image_region: dict[str, Any] | None


class DiagnosisRecord(Struct, kw_only=True):
    """The whole file; further keys are free at every level."""

    schema: Literal[1]
    verdict: Verdict
    effects: Annotated[list[EffectRecord], Meta(min_length=2)]
    combination: tuple[str, ...]
    where: WhereRecord
    gap: GapRecord
    equivalent: tuple[Annotated[tuple[str, ...], Meta(min_length=2)], ...]
    excitation: tuple[str, ...]
    warnings: tuple[str, ...]
    absorbed: tuple[str, ...] = ()
    checks: dict[str, Any] = {}
    q_names: tuple[str, ...] = ()
    u_names: tuple[str, ...] = ()
    files: tuple[FileAgreement, ...] = ()
    next_experiments: NextExperiments | None = None


COPIED_FIELDS = tuple(set(DiagnosisRecord.__struct_fields__) - {"schema", "effects", "where", "gap"})
"""Fields that a `Diagnosis` and its record share."""


def save_diagnosis(path: str | os.PathLike[str], diagnosis: Diagnosis) -> None:
    """Write ``diagnosis`` to ``path``, whole or not at all; rollouts and figures have files of their own.

    Raises:
        ValueError: it breaks a rule of the format, such as probabilities that do not sum to one.
    """
    content = build_diagnosis_content(diagnosis)
    check_diagnosis(content)
    write_text(path, json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def load_diagnosis(path: str | os.PathLike[str]) -> Diagnosis:
    """Read a diagnosis back without its blocks; its ``where`` and ``checks`` are plain mappings.

    Raises:
        ValueError: the file is no JSON or no diagnosis.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
        record = check_diagnosis(content)
    except json.JSONDecodeError as error:
        raise ValueError(f"{os.fspath(path)} is not JSON: {error}") from error
    except ValueError as error:
        raise ValueError(f"{os.fspath(path)}: {error}") from error
    return Diagnosis(
        candidates=tuple(_to_candidate(effect) for effect in record.effects),
        gap=_to_gap(record.gap),
        where=content["where"],
        blocks=(),
        **{name: getattr(record, name) for name in COPIED_FIELDS},
    )


def check_diagnosis(content: Mapping[str, Any]) -> DiagnosisRecord:
    """Check that ``content`` is a diagnosis: its fields, their types, and probabilities that sum to one.

    Raises:
        ValueError: it is not; the message says where and why.
    """
    try:
        record = msgspec.convert(content, DiagnosisRecord)
    except msgspec.ValidationError as error:
        reason, _, path = str(error).partition(" - at `$")
        place = path.rstrip("`").replace("[", "/").replace("]", "").replace(".", "/").strip("/")
        raise ValueError(f"not a diagnosis, at {place or 'the whole'}: {reason}") from error
    named = [(f"effects/{index}/name", {effect.name}) for index, effect in enumerate(record.effects)]
    named += [(f"equivalent/{index}", set(names)) for index, names in enumerate(record.equivalent)]
    for place, names in named:
        if unknown := sorted(names - set(list_names())):
            raise ValueError(f"not a diagnosis, at {place}: no known effect is called {', '.join(unknown)}")
    probabilities = [effect.probability for effect in record.effects]
    if not math.isclose(sum(probabilities), 1.0, abs_tol=PROBABILITY_TOLERANCE):
        raise ValueError(f"the probabilities of all effects sum to {sum(probabilities):.9g}, not to 1")
    if probabilities != sorted(probabilities, reverse=True):
        raise ValueError("the effects are not in the order of their probabilities, the most probable first")
    candidates = {effect.name for effect in record.effects}
    for name in VERDICTS:
        if name not in candidates:
            raise ValueError(f"`{name}` is missing among the effects; it is always a candidate")
    if missing := sorted(set(record.combination) - candidates):
        raise ValueError(f"the combination names {', '.join(missing)}, not among the effects")
    return record


def build_diagnosis_content(diagnosis: Diagnosis) -> dict[str, Any]:
    """Build the content of the file as plain data, its keys in the order of the record classes.

    A missing part of ``where`` is empty, and listed as ``not_computed``.
    """
    fields = {name: to_plain_data(getattr(diagnosis, name)) for name in COPIED_FIELDS}
    fields["schema"] = SCHEMA
    for suggestion in (fields["next_experiments"] or {}).get("suggestions", ()):
        del suggestion["input"]  # it is in a table of its own
    fields["effects"] = []
    for candidate in diagnosis.candidates:
        closure = {"closure": to_plain_data(candidate.closure or NO_INTERVAL)}
        fields["effects"].append(_in_order(EffectRecord, to_plain_data(candidate) | closure))
    location = read_location(diagnosis)
    where = {name: to_plain_data(location.get(name) or empty) for name, empty in EMPTY_WHERE.items()}
    for name in OPTIONAL_WHERE:
        if location.get(name) is not None:
            where[name] = to_plain_data(location[name])
    fields["where"] = where | {"not_computed": list_missing_fields(diagnosis)}
    unit = {"unit": "fraction of each coordinate's rms"}
    fields["gap"] = _in_order(GapRecord, to_plain_data(diagnosis.gap or NO_GAP) | unit)
    return _in_order(DiagnosisRecord, fields)


def _in_order(record: type[Struct], fields: Mapping[str, Any]) -> dict[str, Any]:
    return {name: fields[name] for name in record.__struct_fields__}


def _to_candidate(effect: EffectRecord) -> Candidate:
    fields = asdict(effect)
    fields["parameters"] = {name: Parameter(**asdict(fit)) for name, fit in effect.parameters.items()}
    if effect.closure.value is None and effect.closure.low is None:
        fields["closure"] = None
    if effect.log_evidence is None:
        fields["log_evidence"] = NAN
    return Candidate(**fields)


def _to_gap(record: GapRecord) -> Gap | None:
    if record.before is None or record.after is None:
        return None
    # A number that could not be computed, such as the floor, stays visible as not a number.
    numbers: dict[str, Any] = asdict(record)
    del numbers["unit"]
    numbers = {name: NAN if value is None else value for name, value in numbers.items()}
    return Gap(**numbers)
