"""What was known of a recording before anything was fitted, read from the checks of a diagnosis."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from lagsplat.diagnose.result import Diagnosis
from lagsplat.report.plain_data import plain

TOLD_APART = ("yes", "weak", "no")
SEPARATE = ("findings", "excitation", "undetermined", "chain")


@dataclass(frozen=True)
class Found:
    """One finding of the data's checks: its ``level``, whose it is, and three sentences."""

    level: str
    source: str
    what: str
    why: str
    remedy: str


@dataclass(frozen=True)
class Shown:
    """Whether a recording can show one effect ("yes", "weak" or "no"), why, and what to record instead."""

    effect: str
    excited: str
    reason: str
    record: str


def findings(diagnosis: Diagnosis) -> list[Found]:
    """The findings in ``checks["findings"]``, the gravest first; none where they were not made."""
    rows = [_fields(row) for row in diagnosis.checks.get("findings") or ()]
    names = ("level", "source", "what", "why", "remedy")
    found = [Found(*(str(row.get(name) or "") for name in names)) for row in rows]
    order = {"refuse": 0, "undetermined": 1, "warn": 2}
    return sorted(found, key=lambda one: order.get(one.level, 3))


def excitations(diagnosis: Diagnosis) -> list[Shown]:
    """What the recording can show, family by family, from ``checks["excitation"]``; none where not made."""
    rows = [_fields(row) for row in diagnosis.checks.get("excitation") or ()]
    names = ("effect", "excited", "reason", "record")
    return [Shown(*(str(row.get(name) or "") for name in names)) for row in rows]


def effects_shown(rows: Sequence[Shown], grade: str) -> list[str]:
    """Names of the effects of one grade."""
    return [row.effect for row in rows if row.excited == grade]


def advice(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """What to record to see each effect that this recording shows badly, the likeliest of them first."""
    told = [text.partition(": ")[::2] for text in diagnosis.excitation]
    chance = {one.name: one.probability for one in diagnosis.candidates}
    named = [(name, record) for name, record in told if name not in diagnosis.combination]
    return sorted(named, key=lambda row: -chance.get(row[0], 0.0))


def measures(diagnosis: Diagnosis) -> dict[str, Any]:
    """The other checks as plain values by name."""
    return {
        str(name): plain(value) for name, value in diagnosis.checks.items() if name not in SEPARATE
    }  # fmt: skip


def reasons(diagnosis: Diagnosis) -> list[str]:
    """Why nothing can be decided, most telling first; one general sentence where no reason was given."""
    told = diagnosis.checks.get("undetermined") or ()
    if isinstance(told, str):
        told = (told,)
    grave = [one for one in findings(diagnosis) if one.level == "undetermined"]
    found = [str(one) for one in told] or [f"{one.what}; {one.why}" for one in grave]
    return (
        found or list(diagnosis.warnings[:1]) or ["the candidates explain the recording about equally well"]
    )


def _fields(row: Any) -> Mapping[str, Any]:
    made = plain(row)
    if not isinstance(made, Mapping):
        raise TypeError(f"a check must have named fields, but is {row!r}")
    return made
