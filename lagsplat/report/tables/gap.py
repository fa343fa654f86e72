"""The table of the sim-to-real gaps of every system, as data and for print."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from lagsplat.diagnose.effects.registry import short_title
from lagsplat.report.common.formatting import capitalize_first, join_distinct
from lagsplat.report.common.printed_table import (
    DASH,
    Cell,
    Column,
    PrintedTable,
    Row,
    lay_out,
    make_number_column,
    make_text_column,
)
from lagsplat.report.common.table_rows import name_block

HELD_OUT = "held_out"
GAP_COLUMNS = (
    *("system", "against", "planted", "verdict", "found", "probability", "level", "before", "refit", "after"),
    *("floor", "closure", "closure_low", "closure_high", "blocks", "diverged_before", "diverged_after"),
    *("image_before", "image_after", "image_floor", "horizon_s", "conditional_on_perception"),
    *("recording", "profile"),
)
BLIND_MAIN = ("top-1, class", "top-2, class", "false alarms", "abstention, outside", "false abstention")
BLIND_COLUMNS = 5  # of the other tables, so that each fits on a page
HIGH_IS_BETTER = ("top-", "abstention", "macro F1", "closure", "two effects", "where:")
LOW_IS_BETTER = ("false", "wrong", "recordings with", "calibration error", "Brier", "parameter error")
"""How the names of metrics begin."""
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


def lay_out_gap(table: pd.DataFrame, *, titles: Mapping[str, str]) -> list[PrintedTable]:
    """Lay out the table of `build_gap_table`; ``titles`` gives the name of each system."""
    columns = [
        make_text_column("Held against", _describe_reference, wrap_em=11),
        make_text_column("Found", _describe_finding, wrap_em=11),
        make_number_column("probability", "p", digits=2),
        *(
            make_number_column(key, title, "(%)", scale=100.0)
            for key, title in (("before", "Gap"), ("refit", "Refit"), ("after", "After"), ("floor", "Floor"))
        ),
        make_text_column(
            "Diverged",
            _count_diverged,
            note="Diverged: forecasts of the sim and with what was found, which all count.",
        ),
    ]
    notes = [
        "Gap: rms error of held-out forecasts over one natural period, as a share of each latent's rms, of "
        "the sim as fitted; refit: with its own parameters fitted again; after: with what was found added; "
        "floor: of the true model, given the noise."
    ]
    if table["planted"].notna().any():
        notes.append("With an effect: a second recording, under other inputs, of a system that has it.")
    return [
        lay_out(
            table,
            columns,
            label="tab:gap",
            lead="The gap between each fitted system and its recordings.",
            caption=(
                "What a diagnosis found, with its probability p. Effects that a fit takes up in its own "
                f"terms cannot be found in its own recording. Profile {join_distinct(table['profile'])}."
            ),
            block=lambda row: name_block(row, titles),
            notes=notes,
        )
    ]


def _describe_reference(row: Row) -> str:
    return "held-out part" if pd.isna(row["planted"]) else f"with {_name_effect(row['planted'])}"


def _describe_finding(row: Row) -> str:
    names = row["found"].split("+") if isinstance(row["found"], str) and row["found"] else []
    return "; ".join(map(_name_effect, names)) or VERDICT_TITLES[row["verdict"]]


def _count_diverged(row: Row) -> str | None:
    counts = [row[key] for key in ("diverged_before", "diverged_after", "blocks")]
    if any(pd.isna(count) for count in counts):
        return None
    before, after, blocks = map(int, counts)
    return f"{before}, {after} of {blocks}"


def _name_effect(name: str) -> str:
    return "nothing planted" if name == "none" else short_title(name)


def lay_out_blind(table: pd.DataFrame) -> list[PrintedTable]:
    """Lay out the blind check, methods down: what readers look for, and the other metrics.

    ``table`` has a row for each ``metric`` of each ``tier`` and a column for each method, whose texts begin
    with a number and may go on with its interval; ``recordings`` tells of what a tier is.
    """
    methods = [name for name in table.columns if name not in ("tier", "recordings", "metric")]
    rows = [
        {"tier": tier, "recordings": part.get("recordings", part["tier"]).iloc[0], "method": method}
        | dict(zip(part["metric"], part[method], strict=True))
        for tier, part in table.groupby("tier", sort=False)
        for method in methods
        if part[method].notna().any()
    ]
    metrics = list(dict.fromkeys(table["metric"]))
    rest = [metric for metric in metrics if metric not in BLIND_MAIN]
    parts = [list(BLIND_MAIN), *(rest[at : at + BLIND_COLUMNS] for at in range(0, len(rest), BLIND_COLUMNS))]
    method = make_text_column("Method", lambda row: row["method"].replace("_", " "))
    return [
        lay_out(
            pd.DataFrame(rows),
            [method, *map(_make_metric_column, part)],
            label="tab:gap-blind" + (f"-{number}" if number else ""),
            lead=f"The blind check of the diagnosis{': further metrics' if number else ''}.",
            caption="Recordings whose answers were sealed before anything was predicted; brackets: Wilson's "
            "95 % intervals.",
            block=lambda row: row["recordings"],
            compared=("tier",),
        )
        for number, part in enumerate(parts)
    ]


def _make_metric_column(metric: str) -> Column:
    """The column of a metric, its heading broken at the space nearest to the middle."""
    spaces = [at for at, letter in enumerate(metric) if letter == " "]
    middle = min(spaces, key=lambda at: abs(at - len(metric) / 2), default=len(metric))
    sign = 1.0 if metric.startswith(LOW_IS_BETTER) else -1.0

    def read(row: Row) -> list[str]:
        text = row.get(metric)
        return re.findall(r"^[\d.]+|\[.*?\]", text) if isinstance(text, str) else []

    def write(row: Row) -> Cell:
        text, *interval = read(row) or [DASH]
        return Cell(text, "".join(interval))

    def rank(row: Row) -> float | None:
        numbers = read(row)
        return sign * float(numbers[0]) if numbers else None

    is_ranked = metric.startswith((*LOW_IS_BETTER, *HIGH_IS_BETTER))
    title, below = capitalize_first(metric[:middle]), metric[middle:].strip()
    return Column(title, write, below, rank=rank if is_ranked else None)
