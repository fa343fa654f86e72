"""The form of ``diagnosis.json``, and whether a file has it."""

import math
from collections.abc import Mapping
from typing import Any, get_args

from jsonschema import Draft202012Validator

from lagsplat.diagnose.result import SCHEMA, Verdict
from lagsplat.report.effect_words import WORDS

SUMS_TO = 1e-6
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
    if not math.isclose(sum(likely), 1.0, abs_tol=SUMS_TO):
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
    name = {"enum": list(WORDS)}
    texts = {"type": "array", "items": {"type": "string"}}
    interval = _object(value=number, low=number, high=number)
    parameter = _object(value=numbers, low=numbers, high=numbers, unit={"type": "string"})
    effect = _object(
        name=name,
        probability={"type": "number", "minimum": 0.0, "maximum": 1.0 + SUMS_TO},
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
