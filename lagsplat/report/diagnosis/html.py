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
from lagsplat.report.common.formatting import (
    capitalize_first,
    format_number,
    format_percent,
    format_probability,
)
from lagsplat.report.common.style import encode_svg_uri
from lagsplat.report.diagnosis.content import (
    MAX_RECOMMENDED,
    NEXT_INPUTS,
    ReportContent,
    compute_remaining,
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
from lagsplat.report.diagnosis.lines import list_answers, qualify_verdict
from lagsplat.report.diagnosis.summary import (
    MAX_NAMED,
    format_estimates,
    is_named,
    join_texts,
    list_indistinguishable,
    name_candidate,
    name_joint_cause,
    select_chosen,
    write_headline,
    write_summary,
)

DESCRIBED_FROM = 0.02  # probability from which the page describes a candidate
MAX_GLOSSES = 2  # terms that the head of the page explains
MAX_TILE_NUMBERS = 6  # numbers that fit into one tile
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
    drawn, planned = draw_diagnosis_figures(diagnosis, content), diagnosis.next_experiments
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
        "left": lambda closure: _format_remaining(compute_remaining(diagnosis.gap, closure)),
        "evidence": _format_evidence,
        "percent": format_percent,
        "number": lambda value: "–" if value is None else format_number(value, digits=3),
    }
    return environment.get_template("report.html.j2").render(
        diagnosis=diagnosis,
        content=content,
        headline=write_headline(diagnosis),
        certainty=qualify_verdict(diagnosis),
        glosses=_list_glosses(diagnosis),
        facts=_list_facts(diagnosis),
        paragraph=write_summary(diagnosis),
        files=list(dict.fromkeys(os.path.basename(block.file) for block in diagnosis.blocks)),
        tiles=_list_tiles(diagnosis),
        numbers=_list_numbers(diagnosis),
        moves=list_refit_moves(diagnosis),
        joints=list_joints(diagnosis),
        findings=list_findings(diagnosis),
        excitations=diagnosis.checks.get("excitation", ()),
        between=planned.between if planned is not None and planned.suggestions else (),
        recordings=_list_recordings(diagnosis),
        agreements=diagnosis.files,
        warnings=_select_warnings(diagnosis),
        figures={drawing.key: drawing for drawing in drawn if drawing.figure is not None},
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


def _end_sentence(text: str) -> str:
    """Add a full stop, and a capital unless the text begins with the name of a file or a column."""
    first = text.partition(" ")[0]
    capital = capitalize_first(text) if first.isalpha() else text
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


def _format_remaining(left: Interval) -> str:
    if left.value is None:
        return "–"
    text = format_percent(left.value)
    if left.low is None or left.high is None:
        return text
    return f"{text} [{format_percent(left.low)}, {format_percent(left.high)}]"


def _list_glosses(diagnosis: Diagnosis) -> list[str]:
    """Say once what each term of the headline means."""
    if diagnosis.verdict == "undetermined":
        return []
    if diagnosis.verdict != "effect":
        return [describe_effect(diagnosis.verdict).symptom]
    names = [effect.name for effect in select_chosen(diagnosis)]
    names = names if len(names) > 1 else list_indistinguishable(diagnosis)[:MAX_GLOSSES]
    terms = [f"{capitalize_first(short_title(name))}: " if len(names) > 1 else "" for name in names]
    return [f"{term}{describe_effect(name).what}" for term, name in zip(terms, names, strict=True)]


def _list_facts(diagnosis: Diagnosis) -> list[tuple[str, list[str]]]:
    """Question and answers, in the order in which readers ask."""
    answers = list_answers(diagnosis)
    rows = {
        "Size": _list_sizes(diagnosis),
        "Gap": [answers["gap"]],
        "Where": [answers["where"]] if diagnosis.verdict != "none" and diagnosis.gap else [],
        "Shrinks": [answers["shrinks"]] if diagnosis.verdict != "none" and diagnosis.gap else [],
        "So far": _list_nearest(diagnosis),
        "Cannot be shown": [],
        "Do now": [answers["next"]],
    }
    if diagnosis.verdict == "none" and (hidden := list_excited(diagnosis, "no")):
        rows["Cannot be shown"] = [
            capitalize_first(join_texts([short_title(name) for name in hidden[:MAX_NAMED]], "or"))
        ]
    return [(question, texts) for question, texts in rows.items() if texts]


def _list_sizes(diagnosis: Diagnosis) -> list[str]:
    """The parameters of each effect found, with its name where that is not the headline."""
    if diagnosis.verdict != "effect":
        return []
    chosen = [effect for effect in select_chosen(diagnosis) if effect.parameters]
    alone = len(chosen) == len(list_indistinguishable(diagnosis)) == 1
    sizes = ["; ".join(format_estimates(effect)) for effect in chosen]
    names = [capitalize_first(name_candidate(effect)) for effect in chosen]
    return sizes if alone else [f"{name}: {size}" for name, size in zip(names, sizes, strict=True)]


def _list_nearest(diagnosis: Diagnosis) -> list[str]:
    """What the most probable effects would leave, where none of them is established."""
    if diagnosis.verdict == "none" or is_named(diagnosis):
        return []
    nearest = [c for c in diagnosis.candidates if c.name not in VERDICTS and c.probability >= DESCRIBED_FROM]
    texts = []
    for candidate in nearest[:MAX_RECOMMENDED]:
        left = compute_remaining(diagnosis.gap, candidate.closure).value
        leaves = "" if left is None else f", would leave {format_percent(left)}"
        texts.append(f"{name_candidate(candidate)} ({format_probability(candidate.probability)}{leaves})")
    return [f"Nearest, and not established: {join_texts(texts, 'and')}"] if texts else []


def _list_recordings(diagnosis: Diagnosis) -> list[str]:
    """What to record next: planned experiments, and then what shows other effects."""
    planned = diagnosis.next_experiments
    texts = []
    for number, each in enumerate(planned.suggestions if planned else (), start=1):
        played = f" Play {NEXT_INPUTS.format(number)}." if len(each.input) > 1 else ""
        texts.append(_end_sentence(each.text) + played)
    texts += [
        f"{capitalize_first(short_title(name))}: {_end_sentence(text)}"
        for name, text in recommend_recordings(diagnosis)
    ]
    return texts[:MAX_RECOMMENDED]


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
