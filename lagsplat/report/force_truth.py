"""The table of answers to known forces against the true ones of the simulated systems."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from lagsplat.report.latex import block_title, cells, escape, latex_float, number, scaled
from lagsplat.report.runs import grouped

ERRORS = (
    "direction_deg",
    "shape",
    "amplitude",
    "pictured_direction_deg",
    "pictured_shape",
    "pictured_amplitude",
)
COLUMNS = ("system", "what", "n", *(f"{name}{end}" for name in ERRORS for end in ("", "_p90")), "error",
           "span", "scale_low", "scale_high", "refused", "recording", "profile", "n_seeds")  # fmt: skip


def force_rows(runs: Sequence[Mapping[str, Any]], metrics: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of each simulated system, medians over seeds: inside the visited range with a brush and with one
    Gaussian, each level of force, the answer in time, and the first motion with three masses.
    """
    rows: list[dict[str, Any]] = []
    for place, variants in grouped(runs, metrics).items():
        context = {"system": place.system, "recording": place.recording, "profile": place.profile}
        for members in variants.values():
            told = [_rows(run["truth"]) for run in members if run["truth"] is not None]
            for what in dict.fromkeys(name for one in told for name in one):
                same = [one[what] for one in told if what in one]
                rows.append({**context, "what": what, "n_seeds": len(same), **_medians(same)})
    return rows


def force_table(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """The rows of `force_rows` with the columns `COLUMNS`."""
    return pd.DataFrame(list(rows), dtype=object).reindex(columns=list(COLUMNS))


def latex_forces(rows: Sequence[Mapping[str, Any]], *, titles: Mapping[str, str]) -> str:
    """The same table in LaTeX; ``titles`` gives the heading of each system's block."""
    frame, body = force_table(rows), []
    for system, block in frame.groupby("system", sort=False):
        body += [block_title(titles.get(str(system), str(system)), columns=9)]
        body += [_line(row) for row in block.to_dict("records")]
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
    return latex_float(
        head=head, body=body, columns="@{}lcccccccc@{}", caption=caption, label="tab:force-truth"
    )


def _line(row: Mapping[Any, Any]) -> str:
    if isinstance(row["refused"], str):
        return cells(escape(f"{row['what']}: {row['refused']}"), *[""] * 8)

    def cell(name: str) -> str:
        scale = 1.0 if name.endswith("deg") else 100.0
        typical, most = (number(scaled(row.get(f"{name}{end}"), scale)) for end in ("", "_p90"))
        return typical if most == "--" else f"{typical} ({most})"

    spread = [number(row[name]) for name in ("scale_low", "scale_high")]
    what = escape(str(row["what"])) + ("" if "--" in spread else f" [{', '.join(spread)}]")
    what += "" if pd.isna(row["span"]) else f": {number(row['span'])}"
    n = "--" if pd.isna(row["n"]) else f"{row['n']:.0f}"
    return cells(what, n, *(cell(name) for name in ERRORS), number(scaled(row["error"], 100.0)))


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
