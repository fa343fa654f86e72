"""The table of answers to known forces against the true ones of the simulated systems.

The table of what must hold of forces in the picture, beside the paper's own values.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from lagsplat.report.common.formatting import (
    escape_latex,
    format_block_title,
    format_cells,
    format_latex_number,
    format_latex_table,
    rescale,
)
from lagsplat.report.common.published_values import RECORDING
from lagsplat.report.common.table_rows import group_runs

ACCURACY_ERRORS = (
    "direction_deg",
    "shape",
    "amplitude",
    "pictured_direction_deg",
    "pictured_shape",
    "pictured_amplitude",
)
ACCURACY_COLUMNS = ("system", "what", "n", *(f"{name}{end}" for name in ACCURACY_ERRORS for end in ("", "_p90")), "error",
           "span", "scale_low", "scale_high", "refused", "recording", "profile", "n_seeds")  # fmt: skip


def build_force_rows(
    runs: Sequence[Mapping[str, Any]], metrics: Sequence[dict[str, Any]]
) -> list[dict[str, Any]]:
    """Rows of each simulated system, medians over seeds: inside the visited range with a brush and with one
    Gaussian, each level of force, the answer in time, and the first motion with three masses.
    """
    rows: list[dict[str, Any]] = []
    for place, variants in group_runs(runs, metrics).items():
        context = {"system": place.system, "recording": place.recording, "profile": place.profile}
        for members in variants.values():
            told = [_rows(run["truth"]) for run in members if run["truth"] is not None]
            for what in dict.fromkeys(name for one in told for name in one):
                same = [one[what] for one in told if what in one]
                rows.append({**context, "what": what, "n_seeds": len(same), **_medians(same)})
    return rows


def build_force_table(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """The rows of `build_force_rows` with the columns `ACCURACY_COLUMNS`."""
    return pd.DataFrame(list(rows), dtype=object).reindex(columns=list(ACCURACY_COLUMNS))


def format_force_latex(rows: Sequence[Mapping[str, Any]], *, titles: Mapping[str, str]) -> str:
    """The same table in LaTeX; ``titles`` gives the heading of each system's block."""
    frame, body = build_force_table(rows), []
    for system, block in frame.groupby("system", sort=False):
        body += [format_block_title(titles.get(str(system), str(system)), columns=9)]
        body += [_accuracy_line(row) for row in block.to_dict("records")]
    head = [
        r"& & \multicolumn{3}{c}{Matter} & \multicolumn{3}{c}{Picture} & In time \\",
        r"& $n$ & direction ($^\circ$) & shape (\%) & amplitude (\%) & direction ($^\circ$) & shape (\%) & "
        r"amplitude (\%) & (\%) \\",
    ]
    profiles = " and ".join(sorted(set(frame["profile"].dropna().astype(str))))
    caption = (
        "Answers to known forces on known points of the simulated systems against the true ones, which no "
        f"training saw; profile {profiles}; medians over forces, with the 90th percentile in brackets. One "
        "poke sets the energy scale; in brackets behind the kind of grip, the 10th and 90th percentile of "
        "the scale that other pokes of its size would have set, relative to it. Matter: the ways of what the "
        "decoder carries along; picture: ways read off the decoded state through a map from latents to true "
        "coordinates. Direction: of the pushed point; shape: what the best factor leaves of the ways of all "
        "points; amplitude: that factor, less one. Levels: how far the force drives the true state, in "
        "visited ranges. In time: rms error of all ways under a force switched on at rest. First motion: "
        "shape of the acceleration with a mass that is learned, induced by equally heavy Gaussians, or by "
        "the true masses. Span of energies: largest over smallest eigenvalue relative to the true matrix; "
        "one factor makes all energies true where it is 1."
    )
    return format_latex_table(
        head=head, body=body, columns="@{}lcccccccc@{}", caption=caption, label="tab:force-truth"
    )


def _accuracy_line(row: Mapping[Any, Any]) -> str:
    if isinstance(row["refused"], str):
        return format_cells(escape_latex(f"{row['what']}: {row['refused']}"), *[""] * 8)

    def cell(name: str) -> str:
        scale = 1.0 if name.endswith("deg") else 100.0
        typical, most = (format_latex_number(rescale(row.get(f"{name}{end}"), scale)) for end in ("", "_p90"))
        return typical if most == "--" else f"{typical} ({most})"

    spread = [format_latex_number(row[name]) for name in ("scale_low", "scale_high")]
    what = escape_latex(str(row["what"])) + ("" if "--" in spread else f" [{', '.join(spread)}]")
    what += "" if pd.isna(row["span"]) else f": {format_latex_number(row['span'])}"
    n = "--" if pd.isna(row["n"]) else f"{row['n']:.0f}"
    return format_cells(
        what, n, *(cell(name) for name in ACCURACY_ERRORS), format_latex_number(rescale(row["error"], 100.0))
    )


def _rows(truth: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    if "refused" in truth:
        return {"nothing measured": {"refused": truth["refused"]}}
    told: dict[str, dict[str, Any]] = {}
    for name, what in (("brush", "visited, brush"), ("nearest", "visited, one Gaussian")):
        block = truth[name]
        if "refused" in block:
            told[what] = {"refused": block["refused"]}
            continue
        low, _, high = block["scale_of_others"]
        told[what] = {**block["inside"], "scale_low": low, "scale_high": high}
    for level in truth["levels"]:
        if level["n"]:
            own = {name: value for name, value in level.items() if name not in ("level", "distance")}
            told[f"level {level['level']:.2g}"] = own
    moved = truth["in_time"]
    told[f"in time, {moved['length_s']:.2g} s"] = {
        "n": moved["n"], "error": moved["error"], "shape": moved["shape"], "shape_p90": moved["shape_p90"]
    }  # fmt: skip
    if spans := truth["energy_spans"]:
        told |= {f"span of energies, {name}": {"span": value} for name, value in spans.items()}
    for name, shape in (truth["at_once"] or {}).items():
        told[f"first motion, {name} mass"] = {"shape": shape}
    return told


def _medians(same: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name in dict.fromkeys(key for row in same for key in row):
        values = [row[name] for row in same if row.get(name) is not None]
        if name == "refused":
            found[name] = values[0]
        else:
            found[name] = float(np.median(values)) if values else None
    return found


INVARIANTS = (
    "lever_rank", "lever_sign", "left", "right", "background", "typical", "ratio", "force_sum", "answer_sum",
    "small_answer_sum", "chart_state", "chart_picture", "across",
)  # fmt: skip
INVARIANT_COLUMNS = ("system", "method", *INVARIANTS, "recording", "profile", "n_seeds")
PAPER_SYSTEM = "rainbow_rocker"
# The same downward force at three slats: -0.50, -0.76, -0.84; on the other side +1.22. Sums: one force from
# the other two by linearity. Across: in three dimensions, and absolute.
PAPER_INVARIANTS = {
    "left": -0.84, "right": 1.22, "background": 0.007, "typical": 0.50, "ratio": 70.0, "force_sum": 8e-8,
    "across": 3.1e-17,
}  # fmt: skip


def build_invariant_rows(
    runs: Sequence[Mapping[str, Any]],
    metrics: Sequence[dict[str, Any]],
    *,
    solid: Sequence[tuple[Mapping[str, Any], dict[str, Any]]] = (),
) -> list[dict[str, Any]]:
    """A row for each system, medians over seeds, and the paper's own for the system it gives them of.

    ``solid`` are runs with Gaussians in space and the numbers of `lagsplat.evaluate.forces.motion`: a row each.
    """
    rows: list[dict[str, Any]] = []
    for place, variants in group_runs(runs, metrics).items():
        for members in variants.values():
            each = [_values(run["invariants"]) for run in members]
            row: dict[str, Any] = {"system": place.system, "method": "ours", "n_seeds": len(members)}
            for name in INVARIANTS:
                known = [value for values in each if (value := values[name]) is not None]
                row[name] = float(np.median(known)) if known else None
            rows.append(row | {"recording": place.recording, "profile": place.profile})
        if place.system == PAPER_SYSTEM:
            rows.append(
                {"system": place.system, "method": "paper", "recording": RECORDING, "profile": "the paper's"}
                | PAPER_INVARIANTS
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


def build_invariant_table(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """The rows of `build_invariant_rows` with the columns `INVARIANT_COLUMNS`."""
    return pd.DataFrame(list(rows), dtype=object).reindex(columns=list(INVARIANT_COLUMNS))


def format_invariant_latex(rows: Sequence[Mapping[str, Any]], *, titles: Mapping[str, str]) -> str:
    """The same table in LaTeX; ``titles`` gives the heading of each system's block.

    Source: paper, "Applying forces".
    """
    frame, body = build_invariant_table(rows), []
    for system, block in frame.groupby("system", sort=False):
        body += [format_block_title(titles.get(str(system), str(system)), columns=9)]
        body += [_invariant_line(row) for row in block.to_dict("records")]
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
    return format_latex_table(
        head=head, body=body, columns="@{}lcccccccc@{}", caption=caption, label="tab:force-invariants"
    )


def _invariant_line(row: Mapping[Any, Any]) -> str:
    ends = [format_latex_number(row[name]) for name in ("left", "right")]
    return format_cells(
        escape_latex(f"{row['method']} ({row['recording']})"),
        format_latex_number(row["lever_rank"]),
        format_latex_number(rescale(row["lever_sign"], 100.0)),
        "--" if "--" in ends else ", ".join(ends),
        format_latex_number(row["ratio"]),
        *(
            format_order_of_magnitude(row[name])
            for name in ("force_sum", "small_answer_sum", "chart_picture", "across")
        ),
    )


def format_order_of_magnitude(value: float | None) -> str:
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
