"""``report.html``: a diagnosis on one page that needs nothing else, neither files nor a network."""

import math
import os
import re
from collections.abc import Mapping
from typing import Any

from jinja2 import Environment, StrictUndefined

from lagsplat.diagnose.core.result import Candidate, Diagnosis, Interval
from lagsplat.diagnose.effects.descriptions import WORDS, short_title
from lagsplat.io.files.atomic import write_text
from lagsplat.report.common.formatting import format_number, format_percent, format_probability
from lagsplat.report.diagnosis.content import (
    EXCITATION_GRADES,
    ReportContent,
    list_missing_fields,
    read_excitations,
    read_findings,
    read_measures,
    recommend_recordings,
    select_effects,
)
from lagsplat.report.diagnosis.figure_state import encode_video_uri
from lagsplat.report.diagnosis.figures import draw_diagnosis_figures
from lagsplat.report.diagnosis.inline_svg import inline_svg
from lagsplat.report.diagnosis.summary import format_estimates, name_candidate, write_headline, write_summary
from lagsplat.report.diagnosis.template import PAGE, STYLE

EXPLAINED_FROM = 0.02  # probability from which a candidate is explained
MAX_TILE_NUMBERS = 6  # numbers that a tile holds
GRADE_TITLES = {"yes": "Shown well", "weak": "Shown weakly", "no": "Cannot be shown"}
MEASURE_LABELS = {
    "natural_period_s": "natural period (s)",
    "period_s": "natural period (s)",
    "periods": "natural periods recorded",
    "blocks": "blocks to divide into fit and test",
    "noise": "noise of each coordinate (rms)",
    "duration_s": "seconds recorded",
    "windows": "stretches fitted",
    "sim_misfit": "mean square by which the sim misses its own recordings (noise is 1)",
}
"""What is told of the data beforehand; other numbers stand at the end."""


def save_report(path: str | os.PathLike[str], diagnosis: Diagnosis, exhibits: ReportContent) -> None:
    """Write the page, whole or not at all.

    Raises:
        ValueError: as of `render_report`.
        OSError: as of `write_text`.
    """
    write_text(path, render_report(diagnosis, exhibits))


def render_report(diagnosis: Diagnosis, exhibits: ReportContent) -> str:
    """The page as HTML. Every text that comes from data is escaped; what is missing is said to be.

    Raises:
        ValueError: a name that no diagnosis gives, or a film that cannot be encoded.
    """
    drawn = draw_diagnosis_figures(diagnosis, exhibits)
    rows = read_excitations(diagnosis)
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=False)
    environment.filters |= {"sentence": _sentence, "unbroken": _unbroken}
    return environment.from_string(PAGE).render(
        style=STYLE,
        headline=write_headline(diagnosis),
        verdict=diagnosis.verdict,
        paragraph=write_summary(diagnosis),
        files=_files(diagnosis),
        tiles=_tiles(diagnosis),
        numbers=_numbers(diagnosis),
        findings=read_findings(diagnosis),
        checked="findings" in diagnosis.checks,
        shown=_shown(diagnosis),
        equivalent=[[short_title(name) for name in names] for names in diagnosis.equivalent],
        excitations=[_named(row) for row in rows],
        advice=[f"{short_title(name)}: {record}" for name, record in recommend_recordings(diagnosis)],
        warnings=_further(diagnosis),
        absorbed=[short_title(name) for name in diagnosis.absorbed],
        figures=[
            {
                "key": one.key,
                "title": one.title,
                "caption": one.caption,
                "svg": inline_svg(one.figure, key=one.key, title=one.title),
            }
            for one in drawn
            if one.figure is not None
        ],
        film=None if exhibits.film is None else encode_video_uri(exhibits.film),
        slowed=1.0 if exhibits.film is None else exhibits.film.slowed,
        missing=_missing(diagnosis, [one.title for one in drawn if one.figure is None]),
        candidates=[_candidate(one, diagnosis) for one in diagnosis.candidates],
        explained=_explained(diagnosis),
        command=exhibits.command,
        provenance=_provenance(exhibits),
    )


def _sentence(text: str) -> str:
    """With a full stop, and a capital unless it begins with the name of a file or a column."""
    first = text.partition(" ")[0]
    capital = text[:1].upper() + text[1:] if first.isalpha() else text
    return _unbroken(capital.rstrip(".") + ".") if text else ""


def _unbroken(text: str) -> str:
    """With numbers and their per cent signs on one line."""
    return re.sub(r"(?<=\d) %", "\N{NO-BREAK SPACE}%", text)


def _further(diagnosis: Diagnosis) -> list[str]:
    """Warnings that the findings about the data do not hold already."""
    told = [one.what for one in read_findings(diagnosis) if one.what]
    return [text for text in diagnosis.warnings if not any(what in text for what in told)]


def _files(diagnosis: Diagnosis) -> list[str]:
    return list(dict.fromkeys(os.path.basename(block.file) for block in diagnosis.blocks))


def _tiles(diagnosis: Diagnosis) -> list[dict[str, str]]:
    told = {name: _told(value) for name, value in read_measures(diagnosis).items()}
    tiles = [
        {"label": label, "value": told[name]} for name, label in MEASURE_LABELS.items() if told.get(name)
    ]
    if diagnosis.blocks:
        tiles.append({"label": "held-out blocks forecast", "value": str(len(diagnosis.blocks))})
    return tiles


def _numbers(diagnosis: Diagnosis) -> list[dict[str, str]]:
    """The checks that came with the fits."""
    rest = [(name, value) for name, value in read_measures(diagnosis).items() if name not in MEASURE_LABELS]
    told = [(name, _listed(value) if isinstance(value, Mapping) else _told(value)) for name, value in rest]
    return [{"label": name.replace("_", " "), "value": value} for name, value in told if value]


def _listed(values: Mapping[str, Any]) -> str:
    return "; ".join(f"{name}: {told}" for name, value in values.items() if (told := _told(value)))


def _told(value: Any) -> str:
    """A check in a few letters; nothing for one that does not fit."""
    if isinstance(value, Mapping):
        # Noise is told by its size; whether it is white stands among the findings.
        return _told(value["sigma"] if "sigma" in value else list(value.values()))
    if isinstance(value, list):
        several = [_told(one) for one in value]
        return ", ".join(several) if all(several) and len(several) <= MAX_TILE_NUMBERS else ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return str(value)
    return format_number(value) if isinstance(value, float) else value if isinstance(value, str) else ""


def _shown(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    rows = read_excitations(diagnosis)
    shown = []
    for grade in EXCITATION_GRADES:
        names = [short_title(name) for name in select_effects(rows, grade)]
        if names:
            shown.append({"label": GRADE_TITLES[grade], "grade": grade, "names": names})
    return shown


def _named(row: Any) -> dict[str, str]:
    return {
        "effect": short_title(row.effect),
        "excited": row.excited,
        "reason": row.reason,
        "record": row.record,
    }


def _missing(diagnosis: Diagnosis, titles: list[str]) -> list[str]:
    names = (name.removesuffix("_s").removesuffix("_hz") for name in list_missing_fields(diagnosis.where))
    fields = [name.replace("_", " ") for name in names]
    figures = [f"“{title}”" for title in titles]
    return ([f"of where the gap lies: {', '.join(fields)}"] if fields else []) + (
        [f"figures that need more than was computed: {', '.join(figures)}"] if figures else []
    )


def _candidate(one: Candidate, diagnosis: Diagnosis) -> dict[str, Any]:
    kind = "chosen" if one.name in diagnosis.combination else ""
    if one.name in ("none", "unknown"):
        kind = "verdict"
    known = math.isfinite(one.log_evidence) and one.name != "none"
    return {
        "kind": kind,
        "place": name_candidate(one),
        "probability": format_probability(one.probability),
        "parameters": format_estimates(one),
        "closure": _interval(one.closure),
        "evidence": format_number(one.log_evidence, digits=3) if known else "–",
        "misfit": "–" if one.misfit is None else format_number(one.misfit, digits=3),
    }


def _interval(closure: Interval | None) -> str:
    if closure is None or closure.value is None:
        return "–"
    if closure.low is None or closure.high is None:
        return format_percent(closure.value)
    return f"{format_percent(closure.value)} [{format_percent(closure.low)}, {format_percent(closure.high)}]"


def _explained(diagnosis: Diagnosis) -> list[dict[str, Any]]:
    alike = {name for group in diagnosis.equivalent for name in group}
    names = [
        one.name
        for one in diagnosis.candidates
        if one.probability >= EXPLAINED_FROM or one.name in diagnosis.combination or one.name in alike
    ]
    return [{"name": short_title(name), "words": WORDS[name]} for name in dict.fromkeys(names)]


def _provenance(exhibits: ReportContent) -> list[dict[str, str]]:
    stamp = exhibits.stamp
    rows = [(f"SHA-256 of {name}", digest) for name, digest in exhibits.digests.items()]
    if stamp.get("commit"):
        changed = " with changes that are not committed" if stamp.get("dirty") else ""
        rows.append(("commit", f"{stamp['commit']}{changed}"))
    versions = {"python": stamp.get("python"), **(stamp.get("versions") or {})}
    told = ", ".join(f"{name} {version}" for name, version in versions.items() if version)
    rows += [("versions", told)] if told else []
    rows += [("made", str(stamp["time_utc"]))] if stamp.get("time_utc") else []
    return [{"label": label, "value": value} for label, value in rows]
