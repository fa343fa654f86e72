"""The table of the sim-to-real gaps of every system, for reading by machine and by LaTeX."""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from lagsplat.diagnose.effects.registry import short_title
from lagsplat.report.common.formatting import (
    escape_latex,
    format_cells,
    format_latex_number,
    format_latex_table,
)

HELD_OUT = "held_out"
GAP_COLUMNS = (
    "system",
    "against",
    "planted",
    "verdict",
    "found",
    "probability",
    "level",
    "before",
    "refit",
    "after",
    "floor",
    "closure",
    "closure_low",
    "closure_high",
    "blocks",
    "diverged_before",
    "diverged_after",
    "image_before",
    "image_after",
    "image_floor",
    "horizon_s",
    "conditional_on_perception",
    "recording",
    "profile",
)
GAP_MEASURES = ("before", "after", "floor")
VERDICT_TITLES = {"effect": "", "none": "none", "unknown": "unknown", "undetermined": "undetermined"}


def build_gap_rows(
    runs: Sequence[Mapping[str, Any]], diagnoses: Sequence[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """One row a diagnosis: the wildcards of its run, with ``real`` beside them, and what it found."""
    return [_row(run, found) for run, found in zip(runs, diagnoses, strict=True)]


def build_gap_table(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """The rows with the columns `GAP_COLUMNS`."""
    return pd.DataFrame(rows, columns=list(GAP_COLUMNS))


def format_gap_latex(rows: Sequence[Mapping[str, Any]], *, titles: Mapping[str, str]) -> str:
    """The same table in LaTeX; ``titles`` gives the name of each system."""
    body: list[str] = []
    for system in dict.fromkeys(row["system"] for row in rows):
        body.append(r"\midrule")
        for index, row in enumerate(row for row in rows if row["system"] == system):
            name = escape_latex(titles.get(system, system)) if index == 0 else ""
            against = "held-out part" if row["planted"] is None else f"with {_named(row['planted'])}"
            found = "; ".join(_named(one) for one in row["found"].split("+")) if row["found"] else ""
            answer = found or VERDICT_TITLES[row["verdict"]]
            sizes = [
                format_latex_number(None if row[key] is None else 100.0 * row[key]) for key in GAP_MEASURES
            ]
            closure = format_latex_number(
                *(_percent(row[key]) for key in ("closure", "closure_low", "closure_high"))
            )
            chance = "--" if row["probability"] is None else f"${row['probability']:.2f}$"
            texts = (escape_latex(text) for text in (against, answer, row["recording"]))
            held, told, recording = texts
            body.append(format_cells(name, held, told, chance, *sizes, closure, _runaways(row), recording))
    head = [
        r"System & Held against & Found & $p$ & Gap & After & Floor & Closed & Diverged & Recording \\",
        r" & & & & (\%) & (\%) & (\%) & (\%) & & \\",
    ]
    return format_latex_table(
        head=head, body=body, columns="@{}lllccccccl@{}", caption=_caption(rows), label="tab:gap"
    )


def _row(run: Mapping[str, Any], found: Mapping[str, Any]) -> dict[str, Any]:
    gap, checks = found["gap"], found.get("checks") or {}
    image = checks.get("image") or {}
    named = "+".join(found["combination"])
    likely = {effect["name"]: effect for effect in found["effects"]}
    name = found["combination"][0] if named else found["verdict"]
    top = likely.get(name)
    # Of an effect its own interval; of no effect that of the refit alone.
    closed = (gap.get("closure") or {}) if gap else {}
    lost = (gap.get("diverged") or {}) if gap else {}
    own = run["real"] == HELD_OUT
    return {
        "system": run["system"],
        "against": "held-out part" if own else "second recording",
        "planted": None if own else run["real"],
        "verdict": found["verdict"],
        "found": named,
        "probability": None if top is None else top["probability"],
        "level": (found["where"] or {}).get("level"),
        **{key: gap[key] if gap else None for key in ("before", "after", "floor", "horizon_s")},
        "refit": gap.get("refit") if gap else None,
        "closure": closed.get("value"),
        "closure_low": closed.get("low"),
        "closure_high": closed.get("high"),
        "blocks": gap.get("blocks") if gap else None,
        **{f"diverged_{key}": lost.get(key) for key in ("before", "after")},
        **{f"image_{key}": image.get(key) for key in ("before", "after", "floor")},
        "conditional_on_perception": checks.get("conditional_on_perception"),
        "recording": run["recording"],
        "profile": run["profile"],
    }


def _named(name: str) -> str:
    return "nothing planted" if name == "none" else short_title(name)


def _runaways(row: Mapping[str, Any]) -> str:
    """Forecasts that diverged, of the sim and of the sim with what was found, among all."""
    if not row["blocks"]:
        return "--"
    return f"{row['diverged_before']}, {row['diverged_after']} of {row['blocks']}"


def _percent(value: float | None) -> float | None:
    return None if value is None else 100.0 * value


def _caption(rows: Sequence[Mapping[str, Any]]) -> str:
    recordings = " and ".join(sorted({str(row["recording"]) for row in rows}))
    profiles = " and ".join(sorted({str(row["profile"]) for row in rows}))
    planted = any(row["planted"] is not None for row in rows)
    second = (
        " Below each simulated arm: the same sim and encoder against a second simulated recording, under "
        "other pressures, of the arm with the named effect, which the sim has not."
        if planted
        else ""
    )
    return (
        "The gap between each fitted system and the held-out part of its own recording "
        f"({recordings}; profile {profiles}): what a diagnosis found, with its probability p, and the root "
        "mean square error of held-out forecasts over one natural period, as a share of each latent's rms: "
        "of the sim as fitted, with what was found added, and of the true model given the noise. Every "
        "forecast counts, also those that diverged (of the sim, with what was found, of how many). Effects "
        f"that a fit takes up in its own terms cannot be found in its own recording.{second}"
    )
