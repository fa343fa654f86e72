"""The benchmark table of the pneumatic arms, for reading by machine and by LaTeX."""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from lagsplat.evaluate.aggregate import MEASURED
from lagsplat.report.latex import block_title, cells, escape, latex_float
from lagsplat.report.rows import beside_paper, counted, diverged, measured, spreads, told

COLUMNS = (
    "robot",
    "method",
    "dynamics",
    "d",
    *MEASURED,
    "external_force",
    "diverged",
    "recording",
    "profile",
    "n_seeds",
)
SCALES = {"ae_floor": 1e5, "mse_half_second": 1e3, "frequency_error": 1e2}


def benchmark_table(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Our rows and the paper's own beside them, robot by robot.

    The columns are `COLUMNS`, then ``_low`` and ``_high`` of each metric that has a spread anywhere.

    Raises:
        ValueError: no row.
    """
    everything = beside_paper(rows)
    return everything.reindex(columns=[*COLUMNS, *spreads(everything, MEASURED)])


def latex_table(rows: Sequence[Mapping[str, Any]], *, titles: Mapping[str, str]) -> str:
    """The same table in LaTeX, for ``\\input`` in any article (booktabs is used where it is loaded).

    ``titles`` gives the heading of each robot's block. The caption names the recordings, the profiles and
    what the brackets are.
    """
    frame = benchmark_table(rows)
    rollouts = counted(rows)
    body: list[str] = []
    for robot, block in frame.groupby("robot", sort=False):
        body += [block_title(titles.get(str(robot), str(robot)), columns=11)]
        body += [_line(row, rollouts) for row in block.to_dict("records")]
    head = [
        r"Method & Dynamics & $d$ & AE floor & MSE 0.5\,s & $\varepsilon_{\mathrm{freq}}$ & NRMSE & "
        r"Image & Ext. & Diverged & Recording \\",
        r" & & & $(10^{-5})$ & $(10^{-3})$ & (\%) & latent & $/$ floor & force & rollouts & \\",
    ]
    return latex_float(
        head=head, body=body, columns="@{}llccccccccl@{}", caption=_caption(rows), label="tab:krauss"
    )


def _caption(rows: Sequence[Mapping[str, Any]]) -> str:
    recordings = " and ".join(sorted({_named(row) for row in rows}))
    return (
        f"Half-second forecasts, free oscillation and two-period forecasts on the held-out part of the "
        f"{recordings}, {told(rows)} A rollout that diverges stays in every mean, scored no better "
        "than the mean prediction. Rows marked as the paper's are its own numbers, measured on its filmed "
        "recordings, and are not comparable with a simulated one."
    )


def _named(row: Mapping[str, Any]) -> str:
    """A recording as the caption calls it: a file that a user gave need not be what a camera saw."""
    source = row.get("source")
    return f"{row['recording']} recording" + (f" ({source})" if source else "")


def _line(row: Mapping[Any, Any], rollouts: Mapping[tuple[str, str, str], int]) -> str:
    return cells(
        escape(str(row["method"])),
        escape(str(row["dynamics"])),
        str(row["d"]),
        *(measured(row, name, scale=SCALES.get(name, 1.0)) for name in MEASURED),
        escape(str(row["external_force"])),
        diverged(row, rollouts),
        escape(str(row["recording"])),
    )
