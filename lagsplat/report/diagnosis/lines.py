"""A diagnosis in five short lines: verdict, size of the gap, where it lies, how far it shrinks, what next."""

import math
import os
from pathlib import Path

from lagsplat.diagnose.core.result import Diagnosis
from lagsplat.diagnose.effects.registry import VERDICTS, describe_effect
from lagsplat.report.common.formatting import format_number, format_percent, format_probability
from lagsplat.report.diagnosis.content import (
    find_main_coordinate,
    list_findings,
    list_joints,
    read_location,
    recommend_recordings,
)
from lagsplat.report.diagnosis.summary import (
    ACTS_LIKE,
    explain_undecided,
    is_named,
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
    certainty = qualify_verdict(diagnosis)
    certainty = f": {certainty}" if diagnosis.verdict == "undetermined" else f" ({certainty})"
    verdict = f"{write_headline(diagnosis)}{certainty}"
    answers = {"verdict": verdict, **list_answers(diagnosis)}
    texts = [_shorten(f"{name + ':':<9}{text}") for name, text in answers.items()]
    return [*texts[:-1], f"{texts[-1]} (more: {Path(report)})", *_list_joints(diagnosis)]


def list_answers(diagnosis: Diagnosis) -> dict[str, str]:
    """List what a reader asks after the verdict: the gap, where it lies, how far it shrinks, what to do next.

    Sentences without a full stop, by their question; every error is a share of the size of the motion.
    """
    return {
        "gap": _write_size(diagnosis),
        "where": _write_place(diagnosis),
        "shrinks": _write_closure(diagnosis),
        "next": _write_next(diagnosis),
    }


def qualify_verdict(diagnosis: Diagnosis) -> str:
    """Write how certain the verdict is, or why there is none."""
    verdict = diagnosis.verdict
    if verdict == "undetermined":
        return explain_undecided(diagnosis).rstrip(".")
    names = list_indistinguishable(diagnosis) if verdict == "effect" else [verdict]
    probability = sum(sum_probability(diagnosis, name) for name in names)
    within = ", within the sim's tolerances" if diagnosis.checks.get("within_tolerance") else ""
    return f"probability {format_probability(probability)}{within}"


def _list_joints(diagnosis: Diagnosis) -> list[str]:
    """A line for each joint that was diagnosed by itself."""
    texts = []
    for row in list_joints(diagnosis):
        sizes = [format_percent(row[name]) for name in ("before", "after") if row[name] is not None]
        gap = f" (gap {' to '.join(sizes)})" if sizes else ""
        texts.append(_shorten(f"{row['joint'] + ':':<9}{name_joint_cause(row)}{gap}"))
    return texts


def _write_size(diagnosis: Diagnosis) -> str:
    gap = diagnosis.gap
    if gap is None:
        return "not measured, no stretch long enough was left to forecast"
    over = f" over {format_number(gap.horizon_s)} s" if math.isfinite(gap.horizon_s) else ""
    floor = (
        f"; floor {format_percent(gap.floor)}, by {name_floor(diagnosis)}" if math.isfinite(gap.floor) else ""
    )
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
    best = max(components, key=lambda name: components[name], default="unexplained")
    if location["level"] == "dynamics" and best in ACTS_LIKE:
        text += f"; most like {ACTS_LIKE[best]} ({format_percent(components[best])})"
    return text


def _write_closure(diagnosis: Diagnosis) -> str:
    gap = diagnosis.gap
    if gap is None:
        return "not measured"
    refit = f"to {format_percent(gap.refit)} with only the sim's own numbers moved"
    if diagnosis.verdict != "effect" or not diagnosis.combination:
        return f"{refit}; nothing is added"
    names = " and ".join(name_candidate(candidate) for candidate in select_chosen(diagnosis))
    return f"to {format_percent(gap.after)} with {names}; {refit}"


def _write_next(diagnosis: Diagnosis) -> str:
    verdict, record = diagnosis.verdict, _write_recording(diagnosis)
    names = list_indistinguishable(diagnosis) if verdict == "effect" else []
    if len(names) == 1 and is_named(diagnosis):
        return describe_effect(names[0]).remedy.rstrip(".")
    if verdict in VERDICTS:
        told = describe_effect(verdict).remedy.rstrip(".")
        purpose = "to see what this one cannot show" if verdict == "none" else "then"
        return f"{told}; {purpose}, {record}" if record else told
    if verdict == "undetermined":
        return f"Add nothing yet, and {record or 'record for longer, with more motion'}"
    return f"To tell them apart, {record}" if record else describe_effect("unknown").remedy.rstrip(".")


def _write_recording(diagnosis: Diagnosis) -> str:
    """What to record, as part of a sentence; empty where there is no advice."""
    planned = diagnosis.next_experiments
    texts = [each.text.partition(":")[0] for each in planned.suggestions] if planned else []
    texts += [
        finding["remedy"]
        for finding in list_findings(diagnosis)
        if finding["level"] == diagnosis.verdict == "undetermined"
    ]
    texts += [f"record {record}" for _, record in recommend_recordings(diagnosis)]
    text = texts[0].rstrip(".") if texts else ""
    return text[:1].lower() + text[1:]


def _shorten(text: str) -> str:
    """The text, cut at the last word that fits into a line."""
    if len(text) <= MAX_WIDTH:
        return text
    return text[: MAX_WIDTH - 2].rsplit(" ", 1)[0].rstrip(",;:.") + " …"
