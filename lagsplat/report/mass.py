"""The mass ablations of the arms: learned, induced by the decoder, constant, over one frozen autoencoder."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from lagsplat.evaluate.aggregate import aggregate, paired_margin
from lagsplat.report.latex import block_title, cells, escape, latex_float, number, scaled
from lagsplat.report.published import RECORDING
from lagsplat.report.rows import measured, table_row
from lagsplat.report.runs import grouped

MASSES = {"constant_mass": "constant", "induced_mass": "induced by the decoder"}
LEARNED = "learned"
BASELINE = "constant_mass"
INERTIA = ("state_dependence", "span", "condition_median", "condition_max")
SCORES = ("mse_half_second", "frequency_error", "latent_nrmse")
COLUMNS = (
    "robot", "mass", "d", *SCORES, "margin", "margin_low", "margin_high", *INERTIA, "ae_floor", "diverged",
    "recording", "profile", "n_seeds",
)  # fmt: skip
SCALES = {"mse_half_second": 1e3, "margin": 1e3, "frequency_error": 1e2}
# Half-second error and frequency error of the two-segment arm; of the constant mass the first alone.
PAPER = {
    LEARNED: {"mse_half_second": 0.769e-3, "frequency_error": 0.057},
    MASSES["induced_mass"]: {"mse_half_second": 1.33e-3, "frequency_error": 0.069},
    MASSES["constant_mass"]: {"mse_half_second": 4.8e-3},
}
PAPER_ROBOT = "krauss_2seg"


def mass_rows(runs: Sequence[Mapping[str, Any]], metrics: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """A row for each form of the mass on each recording, and the paper's own for the robot it gives them of.

    ``margin`` is how much lower the half-second image error is than with the constant mass on the same
    starts, with its 95 % interval over them. The numbers of `lagsplat.evaluate.inertia.inertia_along` are
    medians over seeds.
    """
    rows: list[dict[str, Any]] = []
    for place, variants in grouped(runs, metrics).items():
        constant = variants.get(BASELINE, [])
        for name, members in variants.items():
            row = table_row(
                aggregate(members),
                robot=place.system,
                method="LaGSplat",
                recording=place.recording,
                profile=place.profile,
            )
            row["mass"] = MASSES.get(name, LEARNED)
            row |= {key: float(np.median([run["inertia"][key] for run in members])) for key in INERTIA}
            if constant and name != BASELINE:
                gain = paired_margin(members, constant, score="mse_half_second")
                row |= {"margin": gain["value"], "margin_low": gain["low"], "margin_high": gain["high"]}
            rows.append(row)
        if place.system == PAPER_ROBOT:
            paper = {"robot": place.system, "d": 4, "recording": RECORDING, "profile": "the paper's"}
            rows += [{**paper, "mass": f"{name} (paper)", **scores} for name, scores in PAPER.items()]
    return rows


def mass_table(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """The rows of `mass_rows` with the columns `COLUMNS`."""
    return pd.DataFrame(list(rows), dtype=object).reindex(columns=list(COLUMNS))


def latex_mass(rows: Sequence[Mapping[str, Any]], *, titles: Mapping[str, str]) -> str:
    """The same table in LaTeX; ``titles`` gives the heading of each robot's block.

    Source: paper, "Decoder-induced inertia".
    """
    frame, body = pd.DataFrame(list(rows), dtype=object), []
    for robot, block in frame.groupby("robot", sort=False):
        body += [block_title(titles.get(str(robot), str(robot)), columns=9)]
        body += [_line(row) for row in block.to_dict("records")]
    head = [
        r"Mass & MSE 0.5\,s & Gain & $\varepsilon_{\mathrm{freq}}$ & NRMSE & State & Span & Condition & "
        r"Recording \\",
        r" & $(10^{-3})$ & $(10^{-3})$ & (\%) & latent & (\%) & & median (max) & \\",
    ]
    return latex_float(
        head=head, body=body, columns="@{}lccccccll@{}", caption=_caption(rows), label="tab:mass"
    )


def _line(row: Mapping[Any, Any]) -> str:
    def cell(name: str) -> str:
        return measured(row, name, scale=SCALES.get(name, 1.0))

    typical, most = (number(row.get(name)) for name in ("condition_median", "condition_max"))
    return cells(
        escape(str(row["mass"])),
        cell("mse_half_second"),
        cell("margin"),
        cell("frequency_error"),
        cell("latent_nrmse"),
        number(scaled(row.get("state_dependence"), 100.0)),
        number(row.get("span")),
        "--" if typical == "--" else f"{typical} ({most})",
        escape(str(row["recording"])),
    )


def _caption(rows: Sequence[Mapping[str, Any]]) -> str:
    ours = [row for row in rows if "n_seeds" in row]
    profiles = " and ".join(sorted({str(row["profile"]) for row in ours}))
    recordings = " and ".join(sorted({str(row["recording"]) for row in ours}))
    return (
        f"Forms of the mass over one frozen autoencoder, held-out part of the {recordings} recording, "
        f"profile {profiles}. Gain: how much lower the half-second error is than with the constant mass on "
        "the same starts, with its 95 % interval over them. State: rms deviation of the mass matrix from its "
        "mean along the trajectory, as a fraction of its rms; span: its largest over its smallest eigenvalue "
        "there, relative to the mean. Rows marked as the paper's are its own numbers, measured on its film."
    )
