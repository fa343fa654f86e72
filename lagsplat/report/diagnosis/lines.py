"""A diagnosis in five short lines: verdict, size of the gap, where it lies, how far it shrinks, what next."""

import math
import os
from pathlib import Path

from lagsplat.diagnose.core.result import Diagnosis
from lagsplat.diagnose.effects.registry import describe_effect, short_title
from lagsplat.report.common.formatting import format_number, format_percent, format_probability
from lagsplat.report.diagnosis.content import (
    find_main_coordinate,
    list_joints,
    read_location,
    recommend_recordings,
)
from lagsplat.report.diagnosis.summary import (
    ACTS_LIKE,
    LIKELY_FROM,
    explain_undecided,
    list_indistinguishable,
    name_candidate,
    name_floor,
    name_joint_cause,
    select_chosen,
    sum_probability,
    write_headline,
)

MAX_WIDTH = 110  # letters of a line
PLACES = {
    "perception": "in the measurement, its sensor or clock",
    "chart": "in how positions are read",
    "actuation": "in how the inputs act",
    "dynamics": "in the motion itself",
}


def write_lines(diagnosis: Diagnosis, *, report: str | os.PathLike[str]) -> list[str]:
    """Write the five lines, each of at most `MAX_WIDTH` letters but for the path of the ``report``.

    Joints that were diagnosed one by one follow, a line each.
    """
    lines = {
        "verdict": _write_verdict(diagnosis),
        "gap": _write_size(diagnosis),
        "where": _write_place(diagnosis),
        "shrinks": _write_closure(diagnosis),
        "next": _write_next(diagnosis),
    }
    texts = [_shorten(f"{name + ':':<9}{text}") for name, text in lines.items()]
    return [*texts[:-1], f"{texts[-1]} (more: {Path(report)})", *_list_joints(diagnosis)]


def _list_joints(diagnosis: Diagnosis) -> list[str]:
    """A line for each joint that was diagnosed by itself."""
    texts = []
    for row in list_joints(diagnosis):
        sizes = [format_percent(row[name]) for name in ("before", "after") if row[name] is not None]
        gap = f" (gap {' to '.join(sizes)})" if sizes else ""
        texts.append(_shorten(f"{row['joint'] + ':':<9}{name_joint_cause(row)}{gap}"))
    return texts


def _write_verdict(diagnosis: Diagnosis) -> str:
    headline, verdict = write_headline(diagnosis), diagnosis.verdict
    if verdict == "undetermined":
        return f"{headline}: {explain_undecided(diagnosis)}"
    names = list_indistinguishable(diagnosis) if verdict == "effect" else [verdict]
    probability = sum(sum_probability(diagnosis, name) for name in names)
    within = ", within the sim's tolerances" if diagnosis.checks.get("within_tolerance") else ""
    return f"{headline}{within} (probability {format_probability(probability)})"


def _write_size(diagnosis: Diagnosis) -> str:
    gap = diagnosis.gap
    if gap is None:
        return "not measured, no stretch long enough was left to forecast"
    over = f" over {format_number(gap.horizon_s)} s" if math.isfinite(gap.horizon_s) else ""
    floor = f"; {name_floor(diagnosis)} alone {format_percent(gap.floor)}" if math.isfinite(gap.floor) else ""
    return f"forecasts{over} miss by {format_percent(gap.before)} of the motion{floor}"


def _write_place(diagnosis: Diagnosis) -> str:
    location, main = read_location(diagnosis), find_main_coordinate(diagnosis)
    if diagnosis.verdict == "none":
        return "no gap to locate"
    if location.get("level") not in PLACES:
        return "not located"
    text, components = PLACES[location["level"]], location.get("components") or {}
    if main is not None and len(location.get("coordinates") or {}) > 1:
        text += f", mostly {main}"
    kinds = {name: share for name, share in components.items() if name in ACTS_LIKE}
    if location["level"] == "dynamics" and kinds:
        best = max(kinds, key=lambda name: kinds[name])
        text += f"; most like {ACTS_LIKE[best]} ({format_percent(kinds[best])})"
    return text


def _write_closure(diagnosis: Diagnosis) -> str:
    gap = diagnosis.gap
    if gap is None:
        return "not measured"
    refit = f"to {format_percent(gap.refit)} with the sim's own numbers moved"
    if diagnosis.verdict != "effect" or not diagnosis.combination:
        return f"{refit}; nothing is added"
    names = " and ".join(name_candidate(candidate) for candidate in select_chosen(diagnosis))
    return f"to {format_percent(gap.after)} with {names}; {refit}"


def _write_next(diagnosis: Diagnosis) -> str:
    names = list_indistinguishable(diagnosis) if diagnosis.verdict == "effect" else []
    if len(names) == 1 and sum_probability(diagnosis, names[0]) >= LIKELY_FROM:
        return describe_effect(names[0]).remedy.rstrip(".")
    for name, record in recommend_recordings(diagnosis)[:1]:
        if record:
            return f"to know more of {short_title(name)}, {record.rstrip('.')}"
    name = "none" if diagnosis.verdict == "none" else "unknown"
    return describe_effect(name).remedy.rstrip(".")


def _shorten(text: str) -> str:
    """The text, cut at the last word that fits into a line."""
    if len(text) <= MAX_WIDTH:
        return text
    return text[: MAX_WIDTH - 2].rsplit(" ", 1)[0].rstrip(",;:.") + " …"
