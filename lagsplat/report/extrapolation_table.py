"""The table of extrapolation in LaTeX: measures down, models across, one block a system."""

from collections.abc import Mapping

import pandas as pd

from lagsplat.report.extrapolation_rows import (
    AUTHORS,
    FLOOR,
    FORECASTER,
    FREE,
    MEASURES,
    ON_FILM,
    OURS,
    PAPER,
    Measure,
)
from lagsplat.report.latex import block_title, cells, escape, latex_float, number, scaled

RENDERING = 4  # measures of pictures, before those of physics
USUAL = (OURS, FORECASTER, FREE, AUTHORS)
HEADS = {
    OURS: "LaGSplat",
    FORECASTER: "Key points",
    FREE: "Neural ODE",
    AUTHORS: "Authors' code",
    PAPER["LaGSplat"]: "LaGSplat",
    PAPER["GaussianPrediction"]: "GaussianPred.",
}


def latex_extrapolation(table: pd.DataFrame, *, titles: Mapping[str, str]) -> str:
    """The rows of `extrapolation_rows` in LaTeX; ``titles`` gives the name of each system.

    A cell without a number is a dash whose footnote says why.

    Source: paper, Table "Extrapolation past the training window".
    """
    here = list(dict.fromkeys(table["model"]))
    variants = [name for name in here if name not in (*USUAL, *PAPER.values())]
    shown = [*USUAL, *variants, *PAPER.values()]
    notes: list[str] = []
    if AUTHORS not in here:
        notes.append("The authors' code needs CUDA and was not run on this recording.")
    body: list[str] = []
    for system, block in table.groupby("system", sort=False):
        body.append(block_title(titles.get(str(system), str(system)), columns=len(shown) + 1))
        for index, measure in enumerate((*MEASURES[:RENDERING], FLOOR, *MEASURES[RENDERING:])):
            if index == RENDERING + 1:
                body.append(r"\addlinespace[2pt]")
            body.append(cells(escape(measure.title), *_line(block, measure, shown, notes)))
    head = [
        rf" & \multicolumn{{{len(USUAL) + len(variants)}}}{{c}}{{this work}} & "
        rf"\multicolumn{{{len(PAPER)}}}{{c}}{{the paper, on its film}} \\",
        cells("", *(escape(HEADS.get(name, name)) for name in shown)),
    ]
    return latex_float(
        head=head,
        body=body,
        columns="@{}l" + "c" * len(shown) + "@{}",
        caption=_caption(table, notes),
        label="tab:extrapolation",
    ).replace(r"\addlinespace[2pt]", r"\noalign{\vskip 2pt}")


def _line(block: pd.DataFrame, measure: Measure, shown: list[str], notes: list[str]) -> list[str]:
    line = []
    for name in shown:
        found = block[(block["model"] == name) & (block["measure"] == measure.name)].to_dict("records")
        if not found:
            line.append(r"--$^{1}$" if name == AUTHORS and notes else "--")
            continue
        row = found[0]
        text = number(*(scaled(row.get(key), measure.scale) for key in ("value", "low", "high")))
        line.append(text + _footnote(row, notes))
    return line


def _footnote(row: Mapping[object, object], notes: list[str]) -> str:
    """A mark at the cell, and what it says in the list of notes, once."""
    if row["n_measured"] == row["n_seeds"]:
        return ""
    note = f"In {row['n_measured']} of {row['n_seeds']} seeds: {row['note']}."
    if note not in notes:
        notes.append(note)
    return rf"$^{{{notes.index(note) + 1}}}$"


def _caption(table: pd.DataFrame, notes: list[str]) -> str:
    own = table[table["recording"] != ON_FILM]
    recordings = " and ".join(sorted(set(own["recording"].astype(str))))
    profiles = " and ".join(sorted(set(own["profile"].astype(str))))
    seeds = "; ".join(
        f"{HEADS.get(str(name), str(name))} {int(group['n_seeds'].iloc[0])}"
        for name, group in own.groupby("model", sort=False)
    )
    told = " ".join(f"({index + 1}) {note}" for index, note in enumerate(notes))
    return (
        f"Extrapolation past the training frames; {recordings} recording, profile {profiles}. Medians over "
        f"seeds with their range ({seeds}). Rendering: PSNR in dB against the recorded frames; with its "
        "phase taken out, each frame is held against the best of those shown up to two frames earlier or "
        "later. Physics is read in the chart of the frozen encoder, over the whole clip and by one estimator "
        "for all: error of the frequency and of the decay rate of the envelope against the encoded clip. "
        "Amplitudes are shares of the clip's first period, at the end of the figure and of the whole "
        "rollout. Key points: a re-implementation of a graph-network forecaster in two dimensions. Columns "
        f"of the paper were measured on its film, another recording. {told}"
    )
