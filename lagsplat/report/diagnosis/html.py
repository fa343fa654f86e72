"""``report.html``: a diagnosis on one page that needs neither other files nor a network.

The page and its style are ``templates/report.html.j2`` and ``templates/report.css``; this module prepares
what they show. Jinja escapes every text that comes from data.
"""

import math
import os
import re
from collections.abc import Mapping
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from lagsplat.diagnose.core.result import Candidate, Diagnosis, Interval
from lagsplat.diagnose.effects.registry import VERDICTS, describe_effect, short_title
from lagsplat.report.common.formatting import format_number, format_percent, format_probability
from lagsplat.report.common.style import encode_svg_uri
from lagsplat.report.diagnosis.content import (
    NEXT_INPUTS,
    ReportContent,
    list_excited,
    list_findings,
    list_joints,
    list_missing_fields,
    list_refit_moves,
    read_measures,
    recommend_recordings,
)
from lagsplat.report.diagnosis.figure_state import encode_video_uri
from lagsplat.report.diagnosis.figures import draw_diagnosis_figures
from lagsplat.report.diagnosis.summary import (
    format_estimates,
    name_candidate,
    name_joint_cause,
    write_headline,
    write_summary,
)

DESCRIBED_FROM = 0.02  # probability from which the page describes a candidate
MAX_TILE_NUMBERS = 6  # numbers that fit into one tile
GRADE_TITLES = {"yes": "Shown well", "weak": "Shown weakly", "no": "Cannot be shown"}
MEASURE_LABELS = {
    "natural_period_s": "natural period (s)",
    "period_s": "natural period (s)",
    "periods": "natural periods recorded",
    "blocks": "blocks to divide into fit and test",
    "noise": "noise of each coordinate (rms)",
    "own_error": "error of the sim's forecasts of its own recordings, of each coordinate (rms)",
    "duration_s": "seconds recorded",
    "windows": "stretches fitted",
    "sim_misfit": "mean square by which the sim misses its own recordings (noise is 1)",
}
"""Measures of the data, which head the page; other numbers stand at its end."""


def render_report(diagnosis: Diagnosis, content: ReportContent) -> str:
    """Render the page as HTML; what was not computed is listed as missing.

    Raises:
        ValueError: a name that no diagnosis gives, or a video that cannot be encoded.
    """
    drawn = draw_diagnosis_figures(diagnosis, content)
    visible = [(grade, title, list_excited(diagnosis, grade)) for grade, title in GRADE_TITLES.items()]
    loader = PackageLoader("lagsplat.report.diagnosis")
    environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined)
    environment.filters |= {
        "sentence": _end_sentence,
        "unbroken": _keep_percent_together,
        "short_title": short_title,
        "svg_uri": encode_svg_uri,
        "place": name_candidate,
        "joint_cause": name_joint_cause,
        "probability": format_probability,
        "estimates": format_estimates,
        "closure": _format_closure,
        "evidence": _format_evidence,
        "percent": format_percent,
        "number": lambda value: "–" if value is None else format_number(value, digits=3),
    }
    return environment.get_template("report.html.j2").render(
        diagnosis=diagnosis,
        content=content,
        headline=write_headline(diagnosis),
        paragraph=write_summary(diagnosis),
        files=list(dict.fromkeys(os.path.basename(block.file) for block in diagnosis.blocks)),
        tiles=_list_tiles(diagnosis),
        numbers=_list_numbers(diagnosis),
        moves=list_refit_moves(diagnosis),
        joints=list_joints(diagnosis),
        findings=list_findings(diagnosis),
        visible=[row for row in visible if row[2]],
        excitations=diagnosis.checks.get("excitation", ()),
        advice=[
            f"{_capitalize(short_title(name))}: {text}" for name, text in recommend_recordings(diagnosis)
        ],
        planned=diagnosis.next_experiments,
        next_inputs=NEXT_INPUTS,
        agreements=diagnosis.files,
        warnings=_select_warnings(diagnosis),
        figures=[drawing for drawing in drawn if drawing.figure is not None],
        video=None if content.video is None else encode_video_uri(content.video),
        # without images nothing is missing of where in them the gap lies
        missing=_list_missing(
            diagnosis,
            [drawing.title for drawing in drawn if drawing.figure is None and drawing.key != "picture"],
        ),
        verdicts=VERDICTS,
        descriptions=_describe_likely(diagnosis),
        provenance=_list_provenance(content.stamp),
    )


def _capitalize(text: str) -> str:
    """Make the first letter a capital and leave the others, as of names, alone."""
    return text[:1].upper() + text[1:]


def _end_sentence(text: str) -> str:
    """Add a full stop, and a capital unless the text begins with the name of a file or a column."""
    first = text.partition(" ")[0]
    capital = text[:1].upper() + text[1:] if first.isalpha() else text
    return _keep_percent_together(capital.rstrip(".") + ".") if text else ""


def _keep_percent_together(text: str) -> str:
    """Keep numbers and their per cent signs on one line."""
    return re.sub(r"(?<=\d) %", "\N{NO-BREAK SPACE}%", text)


def _select_warnings(diagnosis: Diagnosis) -> list[str]:
    """The warnings that are not among the findings about the data already."""
    known = [finding["what"] for finding in list_findings(diagnosis)]
    return [text for text in diagnosis.warnings if not any(what in text for what in known)]


def _list_tiles(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """Value and label of each measure of the data."""
    measures = {name: _format_measure(value) for name, value in read_measures(diagnosis).items()}
    tiles = [(measures[name], label) for name, label in MEASURE_LABELS.items() if measures.get(name)]
    return tiles + ([(str(len(diagnosis.blocks)), "held-out blocks forecast")] if diagnosis.blocks else [])


def _list_numbers(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """Label and value of the checks that came with the fits."""
    rows = []
    for name, value in read_measures(diagnosis).items():
        text = _format_measure(value)
        if isinstance(value, Mapping):
            parts = {key: _format_measure(part) for key, part in value.items()}
            text = "; ".join(f"{key}: {part}" for key, part in parts.items() if part)
        if text and name not in MEASURE_LABELS:
            rows.append((name.replace("_", " "), text))
    return rows


def _format_measure(value: Any) -> str:
    """A check in a few letters; empty where it does not fit into a tile."""
    if isinstance(value, Mapping):
        # Of the noise only its size is shown; whether it is white stands among the findings.
        return _format_measure(value["sigma"] if "sigma" in value else list(value.values()))
    if isinstance(value, list):
        texts = [_format_measure(element) for element in value]
        return ", ".join(texts) if all(texts) and len(texts) <= MAX_TILE_NUMBERS else ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return format_number(value)
    return "" if value is None else str(value)


def _list_missing(diagnosis: Diagnosis, titles: list[str]) -> list[str]:
    missing = [name for name in list_missing_fields(diagnosis) if name != "image_region"]
    names = (name.removesuffix("_s").removesuffix("_hz") for name in missing)
    fields = ", ".join(name.replace("_", " ") for name in names)
    figures = ", ".join(f"“{title}”" for title in titles)
    parts = {"of where the gap lies": fields, "figures that need more than was computed": figures}
    return [f"{what}: {missing}" for what, missing in parts.items() if missing]


def _format_evidence(candidate: Candidate) -> str:
    known = math.isfinite(candidate.log_evidence) and candidate.misfit is not None
    return format_number(candidate.log_evidence, digits=3) if known else "–"


def _format_closure(closure: Interval | None) -> str:
    if closure is None or closure.value is None:
        return "–"
    if closure.low is None or closure.high is None:
        return format_percent(closure.value)
    return f"{format_percent(closure.value)} [{format_percent(closure.low)}, {format_percent(closure.high)}]"


def _describe_likely(diagnosis: Diagnosis) -> list[tuple[str, Any]]:
    """Short title and description of each effect that is likely, chosen, or equivalent to another."""
    named = {name for names in (diagnosis.combination, *diagnosis.equivalent) for name in names}
    likely = [c.name for c in diagnosis.candidates if c.probability >= DESCRIBED_FROM or c.name in named]
    return [(short_title(name), describe_effect(name)) for name in dict.fromkeys(likely)]


def _list_provenance(stamp: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Label and value of everything that says how the diagnosis was made."""
    commit = stamp.get("commit") or ""
    changed = " with changes that are not committed" if commit and stamp.get("dirty") else ""
    versions = {"python": stamp.get("python"), **(stamp.get("versions") or {})}
    rows = {
        "version": str(stamp.get("version") or ""),
        "commit": f"{commit}{changed}",
        "versions": ", ".join(f"{name} {version}" for name, version in versions.items() if version),
        "made": str(stamp.get("time_utc") or ""),
    }
    return [(label, value) for label, value in rows.items() if value]
