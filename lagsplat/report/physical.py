"""The paper's table of free rollouts, for every system, for reading by machine and by LaTeX."""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from lagsplat.report.latex import cells, escape, latex_float
from lagsplat.report.rows import beside_paper, counted, diverged, measured, spreads, told

MEASURED = ("frequency_error", "latent_nrmse", "image_ratio", "ae_floor")
COLUMNS = ("system", "d", *MEASURED, "diverged", "recording", "profile", "n_seeds")
SCALES = {"ae_floor": 1e4, "frequency_error": 1e2}


def physical_table(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Our rows and the paper's own beside them, system by system; the rows are those of `rows_of`.

    The columns are `COLUMNS`, then ``dynamics`` if there are any but the default, then ``_low`` and ``_high``
    of each score that has a spread anywhere.

    Raises:
        ValueError: no row.
    """
    frame = beside_paper(rows).rename(columns={"robot": "system"})
    several = {row["method"] for row in rows} - {"LaGSplat"}
    frame["dynamics"] = [_named(row) for row in frame.to_dict("records")]
    columns = [*COLUMNS, *(["dynamics"] if several else []), *spreads(frame, MEASURED)]
    return frame.reindex(columns=columns)


def latex_physical(rows: Sequence[Mapping[str, Any]], *, titles: Mapping[str, str]) -> str:
    """The same table in LaTeX; ``titles`` gives the name of each system.

    Source: paper, Table "Free rollouts".
    """
    rollouts, body = counted(rows), []
    for system, block in beside_paper(rows).groupby("robot", sort=False):
        body += [r"\midrule"]
        title = escape(titles.get(str(system), str(system)))
        for index, row in enumerate(block.to_dict("records")):
            name = title if index == 0 else rf"\quad {escape(_named(row))}"
            scores = (measured(row, score, scale=SCALES.get(score, 1.0)) for score in MEASURED)
            recording = escape(str(row["recording"]))
            body.append(cells(name, str(row["d"]), *scores, diverged(row, rollouts), recording))
    head = [
        r"System & $d$ & $\varepsilon_{\mathrm{freq}}$ & $\varepsilon_{q}$ & $\varepsilon_{I}$ & "
        r"$\varepsilon_{\mathrm{AE}}$ & Diverged & Recording \\",
        r" & & (\%) & & $(\times\,\varepsilon_{\mathrm{AE}})$ & $(10^{-4})$ & rollouts & \\",
    ]
    return latex_float(
        head=head, body=body, columns="@{}lccccccl@{}", caption=_caption(rows), label="tab:physical"
    )


def _named(row: Mapping[Any, Any]) -> str:
    """The kind of dynamics, with the names of the settings that are not the default, or the paper."""
    said = str(row["method"]).removeprefix("LaGSplat").strip()
    return f"{row['dynamics']} {said}".strip()


def _caption(rows: Sequence[Mapping[str, Any]]) -> str:
    recordings = " and ".join(sorted({str(row["recording"]) for row in rows}))
    return (
        "Free rollouts on the held-out part: error of the free frequency, of the latent state and of the "
        "image over two natural periods, the image's as a multiple of the static error of the autoencoder. "
        f"{recordings.capitalize()} recordings, {told(rows)} A rollout that diverges stays in every mean, "
        "scored no better than the mean prediction, and is counted over all scores of the run. The paper's "
        "own numbers were measured on its filmed recordings, and are not comparable with a simulated one."
    )
