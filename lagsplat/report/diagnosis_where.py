"""What is known of where a gap lies, whichever parts of it were computed or read back."""

from collections.abc import Mapping
from typing import Any

from lagsplat.report.rounding import percent

LOCATED = ("level", "coordinates", "time_s", "frequency_hz", "state_region", "image_region")
"""What every `diagnosis.json` holds."""
FURTHER = ("components", "memory_index", "evidence")
MOSTLY = 0.5
"""Share of the residual from which on a short event is told of."""


def located(where: Any, name: str) -> Any:
    """One field of ``where``, an object or a mapping; None where it was not computed."""
    if isinstance(where, Mapping):
        return where.get(name)
    return getattr(where, name, None)


def not_computed(where: Any) -> tuple[str, ...]:
    """The fields that are missing. An image region of None says that there are no pictures, and is not."""
    if isinstance(where, Mapping) and "not_computed" in where:
        return tuple(where["not_computed"])
    absent = object()

    def has(name: str) -> bool:
        value = where.get(name, absent) if isinstance(where, Mapping) else getattr(where, name, absent)
        return value is not absent and (value is not None or name == "image_region")

    return tuple(name for name in (*LOCATED, "components") if not has(name))


def main_coordinate(where: Any) -> str | None:
    """The coordinate with the largest share of the residual; None where none has any."""
    shares = located(where, "coordinates") or {}
    if not shares or max(shares.values()) <= 0.0:
        return None
    return str(max(shares, key=lambda name: shares[name]))


def brief(where: Any, period_s: float) -> str:
    """When most of the residual acts, in a sentence, if that is within a natural period; else nothing."""
    events = located(where, "time_s") or ()
    if not events:
        return ""
    file, start_s, end_s, share = events[0]
    if share < MOSTLY or not end_s - start_s < period_s:
        return ""
    return f" {percent(share)} of what is missing acts between {start_s:.4g} and {end_s:.4g} s of {file}."
