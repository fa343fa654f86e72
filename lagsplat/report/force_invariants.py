"""The table of what must hold of forces in the picture, beside the paper's own values."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from lagsplat.report.latex import block_title, cells, escape, latex_float, number, scaled
from lagsplat.report.published import RECORDING
from lagsplat.report.runs import grouped

VALUES = (
    "lever_rank", "lever_sign", "left", "right", "background", "typical", "ratio", "force_sum", "answer_sum",
    "small_answer_sum", "chart_state", "chart_picture", "across",
)  # fmt: skip
COLUMNS = ("system", "method", *VALUES, "recording", "profile", "n_seeds")
PAPER_SYSTEM = "rainbow_rocker"
# The same downward force at three slats: -0.50, -0.76, -0.84; on the other side +1.22. Sums: one force from
# the other two by linearity. Across: in three dimensions, and absolute.
PAPER = {
    "left": -0.84, "right": 1.22, "background": 0.007, "typical": 0.50, "ratio": 70.0, "force_sum": 8e-8,
    "across": 3.1e-17,
}  # fmt: skip


def invariants_rows(
    runs: Sequence[Mapping[str, Any]],
    metrics: Sequence[dict[str, Any]],
    *,
    solid: Sequence[tuple[Mapping[str, Any], dict[str, Any]]] = (),
) -> list[dict[str, Any]]:
    """A row for each system, medians over seeds, and the paper's own for the system it gives them of.

    ``solid`` are runs with Gaussians in space and the numbers of `lagsplat.evaluate.force_space`: a row each.
    """
    rows: list[dict[str, Any]] = []
    for place, variants in grouped(runs, metrics).items():
        for members in variants.values():
            each = [_values(run["invariants"]) for run in members]
            row: dict[str, Any] = {"system": place.system, "method": "ours", "n_seeds": len(members)}
            for name in VALUES:
                known = [value for values in each if (value := values[name]) is not None]
                row[name] = float(np.median(known)) if known else None
            rows.append(row | {"recording": place.recording, "profile": place.profile})
        if place.system == PAPER_SYSTEM:
            rows.append(
                {"system": place.system, "method": "paper", "recording": RECORDING, "profile": "the paper's"}
                | PAPER
            )
    for run, numbers in solid:
        rows.append(
            {
                "system": run["system"],
                "method": "ours, in space",
                "across": numbers["felt_across"],
                "n_seeds": 1,
            }
            | {key: run[key] for key in ("recording", "profile")}
        )
    return rows


def invariants_table(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """The rows of `invariants_rows` with the columns `COLUMNS`."""
    return pd.DataFrame(list(rows), dtype=object).reindex(columns=list(COLUMNS))


def latex_invariants(rows: Sequence[Mapping[str, Any]], *, titles: Mapping[str, str]) -> str:
    """The same table in LaTeX; ``titles`` gives the heading of each system's block.

    Source: paper, "Applying forces".
    """
    frame, body = invariants_table(rows), []
    for system, block in frame.groupby("system", sort=False):
        body += [block_title(titles.get(str(system), str(system)), columns=9)]
        body += [_line(row) for row in block.to_dict("records")]
    head = [
        r"& \multicolumn{3}{c}{Lever} & Background & \multicolumn{2}{c}{Sums} & Chart & Across \\",
        r"& rank & sign (\%) & ends & on / off & forces & answers & picture & \\",
    ]
    ours = frame[frame["method"] != "paper"]
    shown = " and ".join(sorted(set(ours["recording"].astype(str))))
    profiles = " and ".join(sorted(set(ours["profile"].astype(str))))
    caption = (
        f"What must hold of forces in the picture whatever the energy scale is; {shown} recordings, profile "
        f"{profiles}; one force a system. Lever: rank correlation of the answer to a downward force with the "
        "lever arm about the centre of rotation, points with its sign, answers at the outermost points "
        "(one coordinate only). Background: typical answer on the object over the largest off it. Sums: "
        "relative error of a sum of two forces as pulled back, and of the answers to forces a hundred "
        "thousandth as large. Chart: largest change of a colour when solved in bent coordinates. Across: "
        "share that is felt of a force across the motion, in the picture or, for a system in space, "
        "on what a ray met first. The paper's row holds its own numbers, on its film of its rocker; its last "
        "is of a force in space, and not a share but the force itself."
    )
    return latex_float(
        head=head, body=body, columns="@{}lcccccccc@{}", caption=caption, label="tab:force-invariants"
    )


def _line(row: Mapping[Any, Any]) -> str:
    ends = [number(row[name]) for name in ("left", "right")]
    return cells(
        escape(f"{row['method']} ({row['recording']})"),
        number(row["lever_rank"]),
        number(scaled(row["lever_sign"], 100.0)),
        "--" if "--" in ends else ", ".join(ends),
        number(row["ratio"]),
        *(power(row[name]) for name in ("force_sum", "small_answer_sum", "chart_picture", "across")),
    )


def power(value: float | None) -> str:
    """A number so small that its order of magnitude is what is told."""
    if value is None or pd.isna(value):
        return "--"
    if value == 0.0:
        return "$0$"
    digits, order = f"{value:.0e}".split("e")
    return rf"${digits}\cdot 10^{{{int(order)}}}$"


def _values(found: Mapping[str, Any]) -> dict[str, float | None]:
    lever, background = found["lever"] or {}, found["background"]
    return {
        "lever_rank": lever.get("rank"),
        "lever_sign": lever.get("sign"),
        "left": lever.get("left"),
        "right": lever.get("right"),
        "background": background["largest"],
        "typical": background["typical"],
        "ratio": background["ratio"],
        "force_sum": found["superposition"]["force"],
        "answer_sum": found["superposition"]["answer"],
        "small_answer_sum": found["superposition"]["small_answer"],
        "chart_state": found["chart"]["state"],
        "chart_picture": found["chart"]["picture"],
        "across": found["across"],
    }
