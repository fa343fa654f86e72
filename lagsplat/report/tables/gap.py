"""The table of the sim-to-real gaps of every system, for reading by machine and by LaTeX."""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from lagsplat.diagnose.effects.registry import short_title
from lagsplat.report.common.formatting import escape_latex, format_cells, format_latex_table, join_distinct
from lagsplat.report.common.table_rows import format_score

HELD_OUT = "held_out"
GAP_COLUMNS = (
    *("system", "against", "planted", "verdict", "found", "probability", "level", "before", "refit", "after"),
    *("floor", "closure", "closure_low", "closure_high", "blocks", "diverged_before", "diverged_after"),
    *("image_before", "image_after", "image_floor", "horizon_s", "conditional_on_perception"),
    *("recording", "profile"),
)
GAP_MEASURES = ("before", "after", "floor", "closure")
VERDICT_TITLES = {"effect": "", "none": "none", "unknown": "unknown", "undetermined": "undetermined"}


def build_gap_rows(
    runs: Sequence[Mapping[str, Any]], diagnoses: Sequence[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Build one row a diagnosis: the wildcards of its run, with ``real`` beside them, and its results."""
    rows = []
    for run, diagnosis in zip(runs, diagnoses, strict=True):
        gap, checks = diagnosis["gap"] or {}, diagnosis.get("checks") or {}
        # Of an effect its own interval; of no effect that of the refit alone.
        closure, diverged = gap.get("closure") or {}, gap.get("diverged") or {}
        image = checks.get("image") or {}
        probabilities = {candidate["name"]: candidate["probability"] for candidate in diagnosis["effects"]}
        main = [*diagnosis["combination"], diagnosis["verdict"]][0]
        held_out = run["real"] == HELD_OUT
        row = {
            "system": run["system"],
            "against": "held-out part" if held_out else "second recording",
            "planted": None if held_out else run["real"],
            "verdict": diagnosis["verdict"],
            "found": "+".join(diagnosis["combination"]),
            "probability": probabilities.get(main),
            "level": (diagnosis["where"] or {}).get("level"),
            **{key: gap.get(key) for key in ("before", "after", "floor", "horizon_s", "refit", "blocks")},
            "closure": closure.get("value"),
            "closure_low": closure.get("low"),
            "closure_high": closure.get("high"),
            **{f"diverged_{key}": diverged.get(key) for key in ("before", "after")},
            **{f"image_{key}": image.get(key) for key in ("before", "after", "floor")},
            "conditional_on_perception": checks.get("conditional_on_perception"),
            "recording": run["recording"],
            "profile": run["profile"],
        }
        rows.append(row)
    return rows


def build_gap_table(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Build the table of the rows of `build_gap_rows`, with the columns `GAP_COLUMNS`."""
    return pd.DataFrame(rows, columns=list(GAP_COLUMNS))


def format_gap_latex(rows: Sequence[Mapping[str, Any]], *, titles: Mapping[str, str]) -> str:
    """Format the rows of `build_gap_rows` in LaTeX; ``titles`` gives the name of each system."""
    body: list[str] = []
    for system in dict.fromkeys(row["system"] for row in rows):
        body.append(r"\midrule")
        for index, row in enumerate(row for row in rows if row["system"] == system):
            title = escape_latex(titles.get(system, system)) if index == 0 else ""
            body.append(format_cells(title, *_format_row(row)))
    planted = any(row["planted"] is not None for row in rows)
    second = (
        " Below each simulated arm: the same sim and encoder against a second simulated recording, under "
        "other pressures, of the arm with the named effect, which the sim has not."
        if planted
        else ""
    )
    return format_latex_table(
        head=[
            r"System & Held against & Found & $p$ & Gap & After & Floor & Closed & Diverged & Recording \\",
            r" & & & & (\%) & (\%) & (\%) & (\%) & & \\",
        ],
        body=body,
        alignment="lllccccccl",
        caption=(
            "The gap between each fitted system and the held-out part of its own recording "
            f"({join_distinct(row['recording'] for row in rows)}; profile "
            f"{join_distinct(row['profile'] for row in rows)}): what a diagnosis found, with its probability "
            "p, and the root mean square error of held-out forecasts over one natural period, as a share of "
            "each latent's rms: of the sim as fitted, with what was found added, and of the true model given "
            "the noise. Every forecast counts, also those that diverged (of the sim, with what was found, of "
            "how many). Effects that a fit takes up in its own terms cannot be found in its own "
            f"recording.{second}"
        ),
        label="tab:gap",
    )


def _format_row(row: Mapping[str, Any]) -> list[str]:
    """All cells but the first."""
    against = "held-out part" if row["planted"] is None else f"with {_name_effect(row['planted'])}"
    effects = "; ".join(_name_effect(name) for name in row["found"].split("+")) if row["found"] else ""
    diverged = f"{row['diverged_before']}, {row['diverged_after']} of {row['blocks']}"
    return [
        escape_latex(against),
        escape_latex(effects or VERDICT_TITLES[row["verdict"]]),
        "--" if row["probability"] is None else f"${row['probability']:.2f}$",
        *(format_score(row, name, scale=100.0) for name in GAP_MEASURES),
        diverged if row["blocks"] else "--",
        escape_latex(row["recording"]),
    ]


def _name_effect(name: str) -> str:
    return "nothing planted" if name == "none" else short_title(name)
