"""The benchmark table of the pneumatic arms, for reading by machine and by LaTeX."""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from lagsplat.evaluate.aggregate import MEASURED
from lagsplat.report.latex import block_title, cells, escape, latex_float
from lagsplat.report.published import paper_baselines, paper_rows
from lagsplat.report.rows import beside_paper, counted, diverged, measured, spreads, told

COLUMNS = (
    "robot",
    "method",
    "dynamics",
    "d",
    *MEASURED,
    "margin",
    "margin_low",
    "margin_high",
    "external_force",
    "diverged",
    "recording",
    "profile",
    "n_seeds",
    "steps",
    "frames_seen",
    "wall_s",
)
SCALES = {"ae_floor": 1e5, "mse_half_second": 1e3, "mse_ahead": 1e3, "frequency_error": 1e2}


def benchmark_table(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Our rows and the paper's own beside them, robot by robot.

    The columns are `COLUMNS`, then ``_low`` and ``_high`` of each metric that has a spread anywhere.

    Raises:
        ValueError: no row.
    """
    everything = beside_paper(rows, _of_paper)
    return everything.reindex(columns=[*COLUMNS, *spreads(everything, MEASURED)])


def _of_paper(robots: set[str]) -> list[dict[str, Any]]:
    return [*paper_rows(robots), *paper_baselines(robots)]


def latex_table(rows: Sequence[Mapping[str, Any]], *, titles: Mapping[str, str]) -> str:
    """The same table in LaTeX, for ``\\input`` in any article (booktabs is used where it is loaded).

    ``titles`` gives the heading of each robot's block. The caption names the recordings, the profiles and
    what the brackets are.
    """
    frame = benchmark_table(rows)
    rollouts = counted(rows)
    body: list[str] = []
    for robot, block in frame.groupby("robot", sort=False):
        body += [block_title(titles.get(str(robot), str(robot)), columns=14)]
        body += [_line(row, rollouts) for row in block.to_dict("records")]
    head = [
        r"Method & Dynamics & $d$ & AE floor & MSE 0.5\,s & from next & $\varepsilon_{\mathrm{freq}}$ & "
        r"NRMSE & Image & Our gain & Ext. & Diverged & Steps & Recording \\",
        r" & & & $(10^{-5})$ & $(10^{-3})$ & $(10^{-3})$ & (\%) & latent & $/$ floor & $(10^{-3})$ & force & "
        r"rollouts & & \\",
    ]
    return latex_float(
        head=head, body=body, columns="@{}llcccccccccccl@{}", caption=_caption(rows), label="tab:krauss"
    )


def _caption(rows: Sequence[Mapping[str, Any]]) -> str:
    recordings = " and ".join(sorted({_named(row) for row in rows}))
    return (
        f"Half-second forecasts, free oscillation and two-period forecasts on the held-out part of the "
        f"{recordings}, {told(rows)} A rollout that diverges stays in every mean, scored no better "
        "than the mean prediction. The half second counts the given initial state as its first; from next, "
        "as many states follow it. Our gain is how much lower the half-second error of LaGSplat is on the "
        "same starts, with its 95 % interval over them. Steps are those of training an image model or a "
        "baseline. External force: where a force given in the image can act. Rows marked as the paper's are "
        "its own numbers, measured on its filmed recordings, and are not comparable with a simulated one."
    )


def _named(row: Mapping[str, Any]) -> str:
    """A recording as the caption calls it: a file that a user gave need not be what a camera saw."""
    source = row.get("source")
    return f"{row['recording']} recording" + (f" ({source})" if source else "")


def _count(value: Any) -> str:
    """A whole number, or a dash where it is not known."""
    return "--" if value is None or pd.isna(value) else f"{int(value)}"


def _line(row: Mapping[Any, Any], rollouts: Mapping[tuple[str, str, str], int]) -> str:
    return cells(
        escape(str(row["method"])),
        escape(str(row["dynamics"])),
        str(row["d"]),
        *(measured(row, name, scale=SCALES.get(name, 1.0)) for name in MEASURED),
        measured(row, "margin", scale=SCALES["mse_half_second"]),
        escape(str(row["external_force"])),
        diverged(row, rollouts),
        _count(row.get("steps")),
        escape(str(row["recording"])),
    )
