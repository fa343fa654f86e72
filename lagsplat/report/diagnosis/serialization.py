"""``diagnosis.json``: written whole and checked, read back as a `Diagnosis`.

The form of ``diagnosis.json``, and whether a file has it.
"""

import json
import math
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args

from jsonschema import Draft202012Validator

from lagsplat.diagnose.core.result import (
    SCHEMA,
    Block,
    Candidate,
    Diagnosis,
    Gap,
    Interval,
    Parameter,
    Verdict,
)
from lagsplat.diagnose.effects.registry import list_names
from lagsplat.io.files.atomic import write_text
from lagsplat.report.diagnosis.content import (
    OPTIONAL_FIELDS,
    get_location,
    list_missing_fields,
    to_plain_data,
)


def save_diagnosis(path: str | os.PathLike[str], diagnosis: Diagnosis) -> None:
    """Write ``diagnosis`` to ``path``, whole or not at all; rollouts and figures have files of their own.

    Raises:
        ValueError: it breaks a rule of the format, such as probabilities that do not sum to one.
        OSError: as of `write_text`.
    """
    content = build_diagnosis_content(diagnosis)
    check_diagnosis(content)
    write_text(path, json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n")


def load_diagnosis(path: str | os.PathLike[str], *, blocks: tuple[Block, ...] = ()) -> Diagnosis:
    """Read a diagnosis back; ``where`` and ``checks`` are then plain mappings. ``blocks`` come from
    `load_rollouts`.

    Raises:
        ValueError: the file is no JSON or no diagnosis.
    """
    try:
        content = json.loads(Path(path).read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise ValueError(f"{os.fspath(path)} is not JSON: {error}") from error
    try:
        check_diagnosis(content)
    except ValueError as error:
        raise ValueError(f"{os.fspath(path)}: {error}") from error
    return Diagnosis(
        verdict=content["verdict"],
        candidates=tuple(_candidate(effect) for effect in content["effects"]),
        combination=tuple(content["combination"]),
        gap=_gap(content["gap"]),
        where=content["where"],
        equivalent=tuple(tuple(names) for names in content["equivalent"]),
        excitation=tuple(content["excitation"]),
        warnings=tuple(content["warnings"]),
        absorbed=tuple(content.get("absorbed", ())),
        blocks=blocks,
        checks=content.get("checks", {}),
        q_names=tuple(content.get("q_names", ())),
        u_names=tuple(content.get("u_names", ())),
    )


def build_diagnosis_content(diagnosis: Diagnosis) -> dict[str, Any]:
    """The content of the file as plain data."""
    return {
        "schema": SCHEMA,
        "verdict": diagnosis.verdict,
        "effects": [_effect(candidate) for candidate in diagnosis.candidates],
        "combination": list(diagnosis.combination),
        "where": build_where_content(diagnosis.where),
        "gap": _gap_content(diagnosis.gap),
        "equivalent": to_plain_data(diagnosis.equivalent),
        "excitation": list(diagnosis.excitation),
        "warnings": list(diagnosis.warnings),
        "absorbed": list(diagnosis.absorbed),
        "checks": to_plain_data(diagnosis.checks),
        "q_names": list(diagnosis.q_names),
        "u_names": list(diagnosis.u_names),
    }


def build_where_content(where: Any) -> dict[str, Any]:
    """Where the gap lies as plain data; empty, and listed as ``list_missing_fields``, where a part is missing."""
    content = {
        "level": get_location(where, "level"),
        "coordinates": to_plain_data(get_location(where, "coordinates") or {}),
        "time_s": to_plain_data(get_location(where, "time_s") or []),
        "frequency_hz": to_plain_data(get_location(where, "frequency_hz") or []),
        "state_region": to_plain_data(get_location(where, "state_region") or {}),
        "image_region": to_plain_data(get_location(where, "image_region")),
    }
    further = {
        name: to_plain_data(get_location(where, name))
        for name in OPTIONAL_FIELDS
        if get_location(where, name) is not None
    }
    return content | further | {"not_computed": list(list_missing_fields(where))}


def _effect(candidate: Candidate) -> dict[str, Any]:
    return {
        "name": candidate.name,
        "probability": to_plain_data(candidate.probability),
        "coordinate": candidate.coordinate,
        "input": candidate.input,
        "places": list(candidate.places),
        "parameters": to_plain_data(candidate.parameters),
        "closure": to_plain_data(candidate.closure or Interval(None, None, None)),
        "log_evidence": to_plain_data(candidate.log_evidence),
        "misfit": to_plain_data(candidate.misfit),
    }


def _gap_content(gap: Gap | None) -> dict[str, Any]:
    # Without a gap the keys stand all the same, so that readers find what they look for.
    names = ("before", "refit", "after", "floor", "horizon_s")
    numbers = {name: None if gap is None else to_plain_data(getattr(gap, name)) for name in names}
    closure = Interval(None, None, None) if gap is None else gap.closure
    counts = {"blocks": gap.blocks if gap else 0, "diverged": dict(gap.diverged) if gap else {}}
    return numbers | {"unit": GAP_UNIT, "closure": to_plain_data(closure)} | counts


def _candidate(effect: Mapping[str, Any]) -> Candidate:
    evidence = effect.get("log_evidence")
    closure = _interval(effect["closure"])
    return Candidate(
        name=effect["name"],
        probability=effect["probability"],
        coordinate=effect["coordinate"],
        input=effect["input"],
        places=tuple(effect.get("places", ())),
        parameters={
            name: Parameter(one["value"], one["low"], one["high"], one["unit"])
            for name, one in effect["parameters"].items()
        },
        closure=None if closure.value is None and closure.low is None else closure,
        log_evidence=float("nan") if evidence is None else evidence,
        misfit=effect.get("misfit"),
    )


def _gap(content: Mapping[str, Any]) -> Gap | None:
    if content["before"] is None or content["after"] is None:
        return None
    # A floor that could not be computed stays visible as not a number.
    floor = float("nan") if content["floor"] is None else content["floor"]
    refit = content.get("refit")
    return Gap(
        before=content["before"],
        refit=float("nan") if refit is None else refit,
        after=content["after"],
        floor=floor,
        horizon_s=float("nan") if content["horizon_s"] is None else content["horizon_s"],
        closure=_interval(content.get("closure") or {}),
        blocks=content.get("blocks", 0),
        diverged=content.get("diverged", {}),
    )


def _interval(content: Mapping[str, Any]) -> Interval:
    return Interval(content.get("value"), content.get("low"), content.get("high"))


PROBABILITY_TOLERANCE = 1e-6
GAP_UNIT = "fraction of each coordinate's rms"
LEVELS = ("perception", "chart", "actuation", "dynamics")


def check_diagnosis(content: Mapping[str, Any]) -> None:
    """Whether ``content`` is a diagnosis: its fields, their kinds, and probabilities that sum to one.

    Further keys are free.

    Raises:
        ValueError: it is not; the message says where and why.
    """
    validator = Draft202012Validator(_schema())
    for error in sorted(validator.iter_errors(content), key=lambda error: list(map(str, error.path))):
        place = "/".join(str(step) for step in error.absolute_path) or "the whole"
        raise ValueError(f"not a diagnosis, at {place}: {error.message}")
    likely = [effect["probability"] for effect in content["effects"]]
    if not math.isclose(sum(likely), 1.0, abs_tol=PROBABILITY_TOLERANCE):
        raise ValueError(f"the probabilities of all effects sum to {sum(likely):.9g}, not to 1")
    if likely != sorted(likely, reverse=True):
        raise ValueError("the effects are not in the order of their probabilities, the most probable first")
    names = {effect["name"] for effect in content["effects"]}
    for name in ("none", "unknown"):
        if name not in names:
            raise ValueError(f"`{name}` is missing among the effects; it is always a candidate")
    strangers = sorted(set(content["combination"]) - names)
    if strangers:
        raise ValueError(f"the combination names {', '.join(strangers)}, not among the effects")


def _schema() -> dict[str, Any]:
    number: dict[str, Any] = {"type": ["number", "null"]}
    numbers: dict[str, Any] = {"anyOf": [number, {"type": "array", "items": number}]}
    text: dict[str, Any] = {"type": ["string", "null"]}
    name = {"enum": list_names()}
    texts = {"type": "array", "items": {"type": "string"}}
    interval = _object(value=number, low=number, high=number)
    parameter = _object(value=numbers, low=numbers, high=numbers, unit={"type": "string"})
    effect = _object(
        name=name,
        probability={"type": "number", "minimum": 0.0, "maximum": 1.0 + PROBABILITY_TOLERANCE},
        coordinate=text,
        input=text,
        parameters={"type": "object", "additionalProperties": parameter},
        closure=interval,
    )
    where = _object(
        level={"enum": [*LEVELS, None]},
        coordinates={"type": "object", "additionalProperties": number},
        time_s=_rows({"type": "string"}, number, number, number),
        frequency_hz=_rows(number, number, number),
        state_region={"type": "object"},
        image_region={"type": ["object", "null"]},
    )
    gap = _object(before=number, after=number, floor=number, unit={"const": GAP_UNIT}, horizon_s=number)
    return _object(
        schema={"const": SCHEMA},
        verdict={"enum": list(get_args(Verdict))},
        effects={"type": "array", "items": effect, "minItems": 2},
        combination={"type": "array", "items": name},
        where=where,
        gap=gap,
        equivalent={"type": "array", "items": {"type": "array", "items": name, "minItems": 2}},
        excitation=texts,
        warnings=texts,
    )


def _object(**properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": properties, "required": list(properties)}


def _rows(*columns: dict[str, Any]) -> dict[str, Any]:
    row = {"type": "array", "prefixItems": list(columns), "minItems": len(columns), "maxItems": len(columns)}
    return {"type": "array", "items": row}
