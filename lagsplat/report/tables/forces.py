"""Answers to forces: against the true ones of simulated systems, and what must hold without a truth."""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from lagsplat.report.common.formatting import (
    escape_latex,
    format_cells,
    format_grouped_table,
    format_latex_number,
    join_distinct,
    rescale,
)
from lagsplat.report.common.published_values import RECORDING
from lagsplat.report.common.table_rows import build_table, format_score, group_runs, take_median

ACCURACY_ERRORS = (
    *("direction_deg", "shape", "amplitude"),
    *("pictured_direction_deg", "pictured_shape", "pictured_amplitude"),
)
ACCURACY_COLUMNS = (
    *("system", "what", "n", *(f"{name}{end}" for name in ACCURACY_ERRORS for end in ("", "_p90"))),
    *("error", "span", "scale_low", "scale_high", "refused", "recording", "profile", "n_seeds"),
)
INVARIANTS = {
    "lever_rank": ("lever", "rank"),
    "lever_sign": ("lever", "sign"),
    "left": ("lever", "left"),
    "right": ("lever", "right"),
    "background": ("background", "largest"),
    "typical": ("background", "typical"),
    "ratio": ("background", "ratio"),
    "force_sum": ("superposition", "force"),
    "answer_sum": ("superposition", "answer"),
    "small_answer_sum": ("superposition", "small_answer"),
    "chart_state": ("chart", "state"),
    "chart_picture": ("chart", "picture"),
}
"""Column, and block and key of `lagsplat.evaluate.forces.invariants.force_invariants`."""
INVARIANT_COLUMNS = ("system", "method", *INVARIANTS, "across", "recording", "profile", "n_seeds")
PAPER_SYSTEM = "rainbow_rocker"
# The same downward force at three slats: -0.50, -0.76, -0.84; on the other side +1.22. Sums: one force from
# the other two by linearity. Across: in three dimensions, and absolute.
PAPER_INVARIANTS = {
    **{"left": -0.84, "right": 1.22, "background": 0.007, "typical": 0.50, "ratio": 70.0},
    **{"force_sum": 8e-8, "across": 3.1e-17},
}


def build_force_rows(
    runs: Sequence[Mapping[str, Any]], metrics: Sequence[dict[str, Any]]
) -> list[dict[str, Any]]:
    """Build the rows of each simulated system, medians over seeds.

    They are: inside the visited range, each level of force, the answer in time, and the first motion with
    three masses.
    """
    rows: list[dict[str, Any]] = []
    for group, variants in group_runs(runs, metrics).items():
        for members in variants.values():
            seeds = [_read_truth(run["truth"]) for run in members if run["truth"] is not None]
            for what in dict.fromkeys(name for seed in seeds for name in seed):
                same = [seed[what] for seed in seeds if what in seed]
                row: dict[str, Any] = {"system": group.system, "what": what, "n_seeds": len(same)}
                for name in dict.fromkeys(key for values in same for key in values):
                    measured = [values[name] for values in same if values.get(name) is not None]
                    row[name] = measured[0] if name == "refused" else take_median(measured)
                rows.append(row | group.place)
    return rows


def format_force_latex(rows: Sequence[Mapping[str, Any]], *, titles: Mapping[str, str]) -> str:
    """Format the rows of `build_force_rows` in LaTeX; ``titles`` gives the heading of each system's block."""
    frame = build_table(rows, ACCURACY_COLUMNS)
    return format_grouped_table(
        frame,
        by="system",
        titles=titles,
        row=_format_accuracy_row,
        head=[
            r"& & \multicolumn{3}{c}{Matter} & \multicolumn{3}{c}{Picture} & In time \\",
            r"& $n$ & direction ($^\circ$) & shape (\%) & amplitude (\%) & direction ($^\circ$) & "
            r"shape (\%) & amplitude (\%) & (\%) \\",
        ],
        alignment="lcccccccc",
        caption=(
            "Answers to known forces on known points of the simulated systems against the true ones, which "
            f"no training saw; profile {join_distinct(frame['profile'].dropna())}; medians over forces, with "
            "the 90th percentile in brackets. One poke sets the energy scale; in brackets behind the first "
            "row's name, the 10th and 90th percentile of the scale that other pokes of its size would have "
            "set, relative to it. Matter: the ways of the field of matter; picture: ways read off the "
            "decoded state through a map from latents to true coordinates. Direction: of the pushed point; "
            "shape: what the best factor leaves of the ways of all points; amplitude: that factor, less one. "
            "Levels: how far the force drives the true state, in visited ranges. In time: rms error of all "
            "ways under a force switched on at rest. First motion: shape of the acceleration with a mass "
            "that is learned, induced by equally heavy points, or by the true masses. Span of energies: "
            "largest over smallest eigenvalue relative to the true matrix; one factor makes all energies "
            "true where it is 1."
        ),
        label="tab:force-truth",
    )


def _format_accuracy_row(row: Mapping[Any, Any]) -> str:
    if isinstance(row["refused"], str):
        return format_cells(escape_latex(f"{row['what']}: {row['refused']}"), *[""] * 8)

    def format_error(name: str) -> str:
        scale = 1.0 if name.endswith("deg") else 100.0
        median, p90 = (format_latex_number(rescale(row.get(f"{name}{end}"), scale)) for end in ("", "_p90"))
        return median if p90 == "--" else f"{median} ({p90})"

    scales = [format_latex_number(row[name]) for name in ("scale_low", "scale_high")]
    what = escape_latex(str(row["what"])) + ("" if "--" in scales else f" [{', '.join(scales)}]")
    what += "" if pd.isna(row["span"]) else f": {format_latex_number(row['span'])}"
    n = "--" if pd.isna(row["n"]) else f"{row['n']:.0f}"
    errors = (format_error(name) for name in ACCURACY_ERRORS)
    return format_cells(what, n, *errors, format_score(row, "error", scale=100.0))


def _read_truth(truth: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """The numbers of one seed, by what was measured."""
    if "refused" in truth:
        return {"nothing measured": {"refused": truth["refused"]}}
    low, _, high = truth["scale_of_others"]
    rows: dict[str, dict[str, Any]] = {"visited": {**truth["inside"], "scale_low": low, "scale_high": high}}
    rows |= {f"level {level['level']:.2g}": level for level in truth["levels"] if level["n"]}
    rows[f"in time, {truth['in_time']['length_s']:.2g} s"] = truth["in_time"]
    if spans := truth["energy_spans"]:
        rows |= {f"span of energies, {name}": {"span": value} for name, value in spans.items()}
    for name, shape in (truth["at_once"] or {}).items():
        rows[f"first motion, {name} mass"] = {"shape": shape}
    return rows


def build_invariant_rows(
    runs: Sequence[Mapping[str, Any]],
    metrics: Sequence[dict[str, Any]],
    *,
    solid: Sequence[tuple[Mapping[str, Any], dict[str, Any]]] = (),
) -> list[dict[str, Any]]:
    """Build a row for each system, medians over seeds, and the paper's own for its system.

    ``solid`` are runs with Gaussians in space and the numbers of `lagsplat.evaluate.forces.motion`: a row
    each.
    """
    rows: list[dict[str, Any]] = []
    for group, variants in group_runs(runs, metrics).items():
        for members in variants.values():
            seeds = [run["invariants"] for run in members]
            row: dict[str, Any] = {"system": group.system, "method": "ours", "n_seeds": len(members)}
            for name, (block, key) in INVARIANTS.items():
                row[name] = take_median((seed[block] or {}).get(key) for seed in seeds)
            rows.append(row | {"across": take_median(seed["across"] for seed in seeds), **group.place})
        if group.system == PAPER_SYSTEM:
            paper = {"system": group.system, "method": "paper", "recording": RECORDING}
            rows.append(paper | {"profile": "the paper's"} | PAPER_INVARIANTS)
    for run, numbers in solid:
        row = {"system": run["system"], "method": "ours, in space", "across": numbers["felt_across"]}
        rows.append(row | {"n_seeds": 1} | {key: run[key] for key in ("recording", "profile")})
    return rows


def format_invariant_latex(rows: Sequence[Mapping[str, Any]], *, titles: Mapping[str, str]) -> str:
    """Format the rows of `build_invariant_rows` in LaTeX; ``titles`` gives the heading of each block.

    Source: paper, "Applying forces".
    """
    frame = build_table(rows, INVARIANT_COLUMNS)
    ours = frame[frame["method"] != "paper"]
    return format_grouped_table(
        frame,
        by="system",
        titles=titles,
        row=_format_invariant_row,
        head=[
            r"& \multicolumn{3}{c}{Lever} & Background & \multicolumn{2}{c}{Sums} & Chart & Across \\",
            r"& rank & sign (\%) & ends & on / off & forces & answers & picture & \\",
        ],
        alignment="lcccccccc",
        caption=(
            "What must hold of forces in the picture whatever the energy scale is; "
            f"{join_distinct(ours['recording'])} recordings, profile {join_distinct(ours['profile'])}; one "
            "force a system. Lever: rank correlation of the answer to a downward force with the lever arm "
            "about the centre of rotation, points with its sign, answers at the outermost points (one "
            "coordinate only). Background: typical answer on the object over the largest where the picture "
            "never changes, infinite where no matter was found there. Sums: "
            "relative error of a sum of two forces as pulled back, and of the answers to forces a hundred "
            "thousandth as large. Chart: largest change of a colour when solved in bent coordinates. Across: "
            "share that is felt of a force across the motion, in the picture or, for a system in space, on "
            "what a ray met first. The paper's row holds its own numbers, on its film of its rocker; its "
            "last is of a force in space, and not a share but the force itself."
        ),
        label="tab:force-invariants",
    )


def _format_invariant_row(row: Mapping[Any, Any]) -> str:
    ends = [format_latex_number(row[name]) for name in ("left", "right")]
    small = ("force_sum", "small_answer_sum", "chart_picture", "across")
    return format_cells(
        escape_latex(f"{row['method']} ({row['recording']})"),
        format_score(row, "lever_rank"),
        format_score(row, "lever_sign", scale=100.0),
        "--" if "--" in ends else ", ".join(ends),
        r"$\infty$" if row["background"] == 0.0 else format_score(row, "ratio"),
        *(format_order_of_magnitude(row[name]) for name in small),
    )


def format_order_of_magnitude(value: float | None) -> str:
    """Format a number of which only one digit and the power of ten matter."""
    if value is None or pd.isna(value):
        return "--"
    if value == 0.0:
        return "$0$"
    digits, order = f"{value:.0e}".split("e")
    return rf"${digits}\cdot 10^{{{int(order)}}}$"
