"""Answers to forces: against the true ones of simulated systems, and what must hold without a truth."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import pandas as pd

from lagsplat.report.common.formatting import capitalize_first, format_interval, join_distinct
from lagsplat.report.common.printed_table import (
    DASH,
    Cell,
    Column,
    PrintedTable,
    Row,
    lay_out,
    make_count_column,
    make_number_column,
    make_text_column,
    write_number,
)
from lagsplat.report.common.published_values import PAPER
from lagsplat.report.common.table_rows import group_runs, name_block, take_median

ACCURACY_ERRORS = (
    *("direction_deg", "shape", "amplitude"),
    *("pictured_direction_deg", "pictured_shape", "pictured_amplitude"),
)
OVER_SEEDS = (*ACCURACY_ERRORS, "error", "span")  # numbers with their range over seeds
ACCURACY_COLUMNS = (
    *("system", "what", "n", *(f"{name}{end}" for name in ACCURACY_ERRORS for end in ("", "_p90"))),
    *("error", "span", "scale_low", "scale_high", "refused", "recording", "profile", "n_seeds"),
    *(f"{name}_{end}" for name in OVER_SEEDS for end in ("low", "high")),
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
OF_LEVER = (
    "Lever: rank correlation of the answer to a downward force with the lever arm about the centre of "
    "rotation, points with its sign, answers at the outermost points (one coordinate only)."
)
OF_BACKGROUND = (
    "Object / background: typical answer on the object over the largest where the picture never changes, ∞ "
    "where no matter was found there."
)
OF_SUMS = (
    "Sums: relative error of a sum of two forces as pulled back, and of the answers to forces a hundred "
    "thousandth as large."
)
OF_BENT_CHART = "Chart: largest change of a colour when solved in bent coordinates."
OF_ACROSS = (
    "Across: share that is felt of a force across the motion, in the picture or, for a system in space, on "
    "what a ray met first; the paper's is the force itself, in space."
)
PAPER_SYSTEM = "rainbow_rocker"
# The same downward force at three slats: -0.50, -0.76, -0.84; on the other side +1.22. Sums: one force from
# the other two by linearity. Across: in three dimensions, and absolute.
PAPER_INVARIANTS = {
    **{"left": -0.84, "right": 1.22, "background": 0.007, "typical": 0.50, "ratio": 70.0},
    **{"force_sum": 8e-8, "across": 3.1e-17},
}


OF_MATTER = "displacements of the field of matter."
OF_PICTURE = "displacements read off the decoded state through a map from latents to true coordinates."
OF_ERRORS = (
    "Direction: of the pushed point; shape: what the best factor leaves of the displacements of all points; "
    "amplitude: that factor, less one."
)
OF_SCALE = (
    "Other pokes' scale: 10th to 90th percentile of what other pokes would have set, relative to this one."
)
OF_MASS = (
    "First motion: shape of the acceleration with a mass that is learned, induced by equally heavy points, "
    "or by the true masses."
)
OF_SPAN = (
    "Span: largest over smallest eigenvalue relative to the true matrix; one factor makes all energies true "
    "where it is 1. Brackets: range over seeds."
)


def build_force_rows(
    runs: Sequence[Mapping[str, Any]], metrics: Sequence[dict[str, Any]]
) -> list[dict[str, Any]]:
    """Build the rows of each simulated system, medians over seeds and, of several, their range.

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
                    if name in OVER_SEEDS and len(set(measured)) > 1:
                        row[f"{name}_low"], row[f"{name}_high"] = min(measured), max(measured)
                rows.append(row | group.place)
    return rows


def lay_out_forces(table: pd.DataFrame, *, titles: Mapping[str, str]) -> list[PrintedTable]:
    """Lay out the table of `build_force_rows`: visited ranges, then every level, then masses.

    ``titles`` gives the heading of each system's block.
    """
    is_main = table["what"].str.match("visited|in time|nothing")
    is_level = table["what"].str.match("visited|level")
    errors = [
        Column(title, _write_error(f"{prefix}{key}", scale), unit, over, note=f"{over}: {note}")
        for prefix, over, note in (("", "Matter", OF_MATTER), ("pictured_", "Picture", OF_PICTURE))
        for key, title, unit, scale in (
            ("direction_deg", "direction", "(°)", 1.0),
            ("shape", "shape", "(%)", 100.0),
            ("amplitude", "amplitude", "(%)", 100.0),
        )
    ]
    in_time = make_number_column(
        *("error", "Error in", "time (%)"),
        scale=100.0,
        note="Error in time: rms of all displacements under a force switched on at rest.",
    )
    scale = Column("Other pokes'", _write_scale, "scale", note=OF_SCALE)
    forces, n = make_text_column("Forces", lambda row: row["what"]), make_count_column("n", "n")
    refused = table[table["refused"].notna()].to_dict("records")
    reasons = [f"{name_block(row, titles)}: {row['refused'].rstrip('.')}." for row in refused]
    profiles = join_distinct(table["profile"].dropna())
    seeds = join_distinct(int(number) for number in table["n_seeds"].dropna())
    caption = f"Profile {profiles}; medians over forces and {seeds} seeds, (brackets): 90th percentile."
    shared: dict[str, Any] = {"block": lambda row: name_block(row, titles)}
    lead = "Answers to known forces"
    return [
        lay_out(
            *(table[is_main], [forces, n, *errors[:3], in_time, scale]),
            label="tab:force-truth",
            lead=f"{lead} against the true ones, which no training saw.",
            caption=f"Simulated systems, after one poke set the energy scale. {caption}",
            notes=[OF_ERRORS, *reasons],
            **shared,
        ),
        lay_out(
            *(table[is_level], [forces, n, *errors]),
            label="tab:force-levels",
            lead=f"{lead}, by how far they drive the true state.",
            caption=f"Levels are in visited ranges. {caption}",
            notes=[OF_ERRORS],
            **shared,
        ),
        lay_out(
            table[~is_main & ~is_level],
            [
                make_text_column("Measure", lambda row: row["what"]),
                make_number_column("shape", "Shape", "(%)", scale=100.0, note=OF_MASS),
                make_number_column("span", "Span", note=OF_SPAN),
            ],
            label="tab:force-masses",
            lead="First motion under a force, and span of energies.",
            caption=f"Simulated systems. {caption}",
            **shared,
        ),
    ]


def _write_error(key: str, scale: float) -> Callable[[Row], Cell]:
    def write(row: Row) -> Cell:
        cell, tail = (write_number(row.get(name), scale=scale, digits=2) for name in (key, f"{key}_p90"))
        return cell if tail.text == DASH else cell._replace(small=f"({tail.text})")

    return write


def _write_scale(row: Row) -> Cell:
    low, high = row.get("scale_low"), row.get("scale_high")
    if low is None or high is None or pd.isna(low) or pd.isna(high):
        return Cell(DASH)
    _, *bounds = format_interval(low, low, high)
    return Cell(" to ".join(bounds))


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
            paper = {"system": group.system, "method": "paper", **PAPER}
            rows.append(paper | PAPER_INVARIANTS)
    for run, numbers in solid:
        row = {"system": run["system"], "method": "ours, in space", "across": numbers["felt_across"]}
        rows.append(row | {"n_seeds": 1} | {key: run[key] for key in ("recording", "profile")})
    return rows


def lay_out_invariants(table: pd.DataFrame, *, titles: Mapping[str, str]) -> list[PrintedTable]:
    """Lay out the table of `build_invariant_rows`; ``titles`` gives the name of each system.

    Source: paper, "Applying forces".
    """
    ours = table[table["method"] != "paper"]
    columns = [
        make_text_column("System", lambda row: titles.get(row["system"], row["system"])),
        make_number_column("lever_rank", "rank", over="Lever", note=OF_LEVER),
        make_number_column("lever_sign", "sign (%)", scale=100.0, over="Lever"),
        Column("ends", _write_ends, over="Lever"),
        Column("Object /", _write_ratio, "background", note=OF_BACKGROUND),
        Column("forces", _write_order("force_sum"), over="Sums", note=OF_SUMS),
        Column("answers", _write_order("small_answer_sum"), over="Sums", note=OF_SUMS),
        Column("Chart", _write_order("chart_picture"), note=OF_BENT_CHART),
        Column("Across", _write_order("across"), note=OF_ACROSS),
    ]
    return [
        lay_out(
            table,
            columns,
            label="tab:force-invariants",
            lead="What must hold of forces in the picture, whatever the energy scale is.",
            caption=f"One force a system; profile {join_distinct(ours['profile'])}; medians over seeds.",
            block=lambda row: capitalize_first(row["recording"]),
        )
    ]


def _write_ends(row: Row) -> Cell:
    left, right = (write_number(row.get(name), digits=2).text for name in ("left", "right"))
    return Cell(DASH if DASH in (left, right) else f"{left}, {right}")


def _write_ratio(row: Row) -> Cell:
    return Cell("∞") if row["background"] == 0.0 else write_number(row.get("ratio"))


def _write_order(key: str) -> Callable[[Row], Cell]:
    """Of a number of which only one digit and the power of ten matter."""

    def write(row: Row) -> Cell:
        return write_number(row.get(key), digits=1)

    return write
