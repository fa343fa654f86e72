"""The learned physics of every system: against its truth, by form of the mass, beside the paper, guaranteed.

Four tables: the truth of the simulated systems; the mass ablations over one frozen autoencoder; the paper's
table of free rollouts; and what no learned Lagrangian can break.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from lagsplat.evaluate.aggregate import aggregate
from lagsplat.report.common.formatting import (
    escape_latex,
    format_cells,
    format_grouped_table,
    format_latex_number,
    format_latex_table,
    join_distinct,
    rescale,
)
from lagsplat.report.common.published_values import RECORDING
from lagsplat.report.common.table_rows import (
    build_row,
    count_rollouts,
    describe_runs,
    format_diverged,
    format_score,
    group_runs,
    list_spread_columns,
    measure_margin,
    merge_with_published,
    name_changes,
)

TRUTH_COLUMNS = ("system", "quantity", "learned", "truth", "error")
TRUTH_CONTEXT = ("encoded", "residual", "recording", "profile", "n_seeds")
TRUTH_SPREAD = ("learned_low", "learned_high")

MASS_TITLES = {"constant_mass": "constant", "induced_mass": "induced by the decoder"}
LEARNED_MASS = "learned"
CONSTANT_MASS = "constant_mass"
INERTIA_MEASURES = ("state_dependence", "span", "condition_median", "condition_max")
MASS_SCORES = ("mse_half_second", "frequency_error", "latent_nrmse")
MASS_COLUMNS = (
    *("robot", "mass", "d", *MASS_SCORES, "margin", "margin_low", "margin_high", *INERTIA_MEASURES),
    *("ae_floor", "diverged", "recording", "profile", "n_seeds"),
)
MASS_SCALES = {"mse_half_second": 1e3, "margin": 1e3, "frequency_error": 1e2}
# Half-second error and frequency error of the two-segment arm; of the constant mass the first alone.
PAPER_MASSES = {
    LEARNED_MASS: {"mse_half_second": 0.769e-3, "frequency_error": 0.057},
    MASS_TITLES["induced_mass"]: {"mse_half_second": 1.33e-3, "frequency_error": 0.069},
    MASS_TITLES["constant_mass"]: {"mse_half_second": 4.8e-3},
}
PAPER_ROBOT = "krauss_2seg"

PHYSICAL_SCORES = ("frequency_error", "latent_nrmse", "image_ratio", "ae_floor")
PHYSICAL_COLUMNS = ("system", "d", *PHYSICAL_SCORES, "diverged", "recording", "profile", "n_seeds")
PHYSICAL_SCALES = {"ae_floor": 1e4, "frequency_error": 1e2}

RUN_FIELDS = ("system", "recording", "profile", "stage1", "ae", "stage2", "seed")
GUARANTEE_FIELDS = (
    *("holds", "rise", "rise_at_half_step", "step_s", "starts", "far", "free_settled", "free_diverged"),
    *("free_time_s", "held_settled", "held_diverged", "held_time_s", "held_force_error", "reason"),
)


def build_truth_table(runs: Sequence[Mapping[str, Any]], metrics: Sequence[dict[str, Any]]) -> pd.DataFrame:
    """Build a row for each quantity of each simulated system; ``runs`` and ``metrics`` as in `group_runs`.

    Over several seeds every number is the median, and ``learned_low`` and ``learned_high`` are the smallest
    and the largest value; ``error`` is the median of the seeds' own errors. Dynamics other than the default
    are named with the quantity. A recording without truth gives no row.

    Raises:
        ValueError: no recording has a truth.
    """
    rows: list[dict[str, Any]] = []
    for group, variants in group_runs(runs, metrics).items():
        for stage2, members in variants.items():
            seeds = [run["truth"]["rows"] for run in members if "truth" in run]
            changed = name_changes(group.stage1, stage2)
            for quantity in dict.fromkeys(row["quantity"] for seed in seeds for row in seed):
                same = [row for seed in seeds for row in seed if row["quantity"] == quantity]
                rows.append(
                    {"system": group.system, "quantity": quantity + changed}
                    | _summarize_seeds(same)
                    | {"recording": group.recording, "profile": group.profile, "n_seeds": len(seeds)}
                )
    if not rows:
        raise ValueError("no run has a truth to compare with: evaluate one of a simulated recording")
    frame = pd.DataFrame(rows, dtype=object)
    spread = [name for name in TRUTH_SPREAD if frame[name].notna().any()]
    return frame.reindex(columns=[*TRUTH_COLUMNS, *TRUTH_CONTEXT, *spread])


def _summarize_seeds(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    summary: dict[str, Any] = {}
    for name in ("learned", "truth", "error", "encoded", "residual"):
        values = [row[name] for row in rows if row[name] is not None]
        summary[name] = float(np.median(values)) if values else None
        if name == "learned":
            several = len(set(values)) > 1
            summary["learned_low"] = min(values) if several else None
            summary["learned_high"] = max(values) if several else None
    return summary


def format_truth_latex(table: pd.DataFrame, *, titles: Mapping[str, str]) -> str:
    """Format the table of `build_truth_table` in LaTeX; ``titles`` gives the name of each system."""

    def format_row(row: Mapping[Any, Any]) -> str:
        return format_cells(
            escape_latex(str(row["quantity"])),
            format_latex_number(row["learned"], row.get("learned_low"), row.get("learned_high")),
            *(format_latex_number(row[name]) for name in ("truth", "encoded")),
            *(format_latex_number(rescale(row[name], 100.0)) for name in ("error", "residual")),
        )

    seeds = " or ".join(sorted(set(table["n_seeds"].astype(str))))
    brackets = " Brackets: range over seeds." if "learned_low" in table else ""
    return format_grouped_table(
        table,
        by="system",
        titles=titles,
        row=format_row,
        head=[r"Quantity & Learned & Truth & Encoded & Error (\%) & Map (\%) \\"],
        alignment="lccccc",
        caption=(
            "Learned physics of the simulated systems against their truth, which no training saw; profile "
            f"{join_distinct(table['profile'])}; medians over seeds ({seeds}).{brackets} A free rollout is "
            "compared with the true motion over the same frames, both measured by the same fit, which also "
            "reads the encoded motion; the linearised law with the eigenvalues of the true equations. Errors "
            "are relative; that of an equilibrium, and the residual of the map by which a latent is read in "
            "true coordinates, are fractions of the motion's rms."
        ),
        label="tab:truth",
    )


def build_mass_rows(
    runs: Sequence[Mapping[str, Any]], metrics: Sequence[dict[str, Any]]
) -> list[dict[str, Any]]:
    """Build a row for each form of the mass on each recording, and the paper's own for its robot.

    ``margin`` is how much lower the half-second image error is than with the constant mass on the same
    starts, with its 95 % interval over them. The numbers of `lagsplat.evaluate.truth.inertia_along` are
    medians over seeds.
    """
    rows: list[dict[str, Any]] = []
    for group, variants in group_runs(runs, metrics).items():
        constant = variants.get(CONSTANT_MASS, [])
        for name, members in variants.items():
            names = {"robot": group.system, "recording": group.recording, "profile": group.profile}
            row = build_row(aggregate(members), method="LaGSplat", **names)
            row["mass"] = MASS_TITLES.get(name, LEARNED_MASS)
            row |= {
                key: float(np.median([run["inertia"][key] for run in members])) for key in INERTIA_MEASURES
            }
            if constant and name != CONSTANT_MASS:
                row |= measure_margin(members, constant, "mse_half_second")
            rows.append(row)
        if group.system == PAPER_ROBOT:
            paper = {"robot": group.system, "d": 4, "recording": RECORDING, "profile": "the paper's"}
            rows += [{**paper, "mass": f"{name} (paper)", **scores} for name, scores in PAPER_MASSES.items()]
    return rows


def build_mass_table(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Build the table of the rows of `build_mass_rows`, with the columns `MASS_COLUMNS`."""
    return pd.DataFrame(list(rows), dtype=object).reindex(columns=list(MASS_COLUMNS))


def format_mass_latex(rows: Sequence[Mapping[str, Any]], *, titles: Mapping[str, str]) -> str:
    """Format the rows of `build_mass_rows` in LaTeX; ``titles`` gives the heading of each robot's block.

    Source: paper, "Decoder-induced inertia".
    """

    def format_row(row: Mapping[Any, Any]) -> str:
        median, largest = (
            format_latex_number(row.get(name)) for name in ("condition_median", "condition_max")
        )
        scores = ("mse_half_second", "margin", "frequency_error", "latent_nrmse")
        return format_cells(
            escape_latex(str(row["mass"])),
            *(format_score(row, name, scale=MASS_SCALES.get(name, 1.0)) for name in scores),
            format_latex_number(rescale(row.get("state_dependence"), 100.0)),
            format_latex_number(row.get("span")),
            "--" if median == "--" else f"{median} ({largest})",
            escape_latex(str(row["recording"])),
        )

    ours = [row for row in rows if "n_seeds" in row]
    return format_grouped_table(
        pd.DataFrame(list(rows), dtype=object),
        by="robot",
        titles=titles,
        row=format_row,
        head=[
            r"Mass & MSE 0.5\,s & Gain & $\varepsilon_{\mathrm{freq}}$ & NRMSE & State & Span & Condition & "
            r"Recording \\",
            r" & $(10^{-3})$ & $(10^{-3})$ & (\%) & latent & (\%) & & median (max) & \\",
        ],
        alignment="lccccccll",
        caption=(
            "Forms of the mass over one frozen autoencoder, held-out part of the "
            f"{join_distinct(row['recording'] for row in ours)} recording, profile "
            f"{join_distinct(row['profile'] for row in ours)}. Gain: how much lower the half-second error is "
            "than with the constant mass on the same starts, with its 95 % interval over them. State: rms "
            "deviation of the mass matrix from its mean along the trajectory, as a fraction of its rms; "
            "span: its largest over its smallest eigenvalue there, relative to the mean. Rows marked as the "
            "paper's are its own numbers, measured on its film."
        ),
        label="tab:mass",
    )


def build_physical_table(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Build the table of our rows and the paper's own, system by system; the rows are those of `build_rows`.

    The columns are `PHYSICAL_COLUMNS`, then ``dynamics`` if there are any but the default, then ``_low`` and
    ``_high`` of each score that has a spread.

    Raises:
        ValueError: no row.
    """
    frame = merge_with_published(rows).rename(columns={"robot": "system"})
    several = {row["method"] for row in rows} - {"LaGSplat"}
    frame["dynamics"] = [_name_dynamics(row) for row in frame.to_dict("records")]
    spread = list_spread_columns(frame, PHYSICAL_SCORES)
    return frame.reindex(columns=[*PHYSICAL_COLUMNS, *(["dynamics"] if several else []), *spread])


def format_physical_latex(rows: Sequence[Mapping[str, Any]], *, titles: Mapping[str, str]) -> str:
    """Format the rows of `build_physical_table` in LaTeX; ``titles`` gives the name of each system.

    Source: paper, Table "Free rollouts".
    """
    rollouts, body = count_rollouts(rows), []
    for system, block in merge_with_published(rows).groupby("robot", sort=False):
        body.append(r"\midrule")
        for index, row in enumerate(block.to_dict("records")):
            dynamics = rf"\quad {escape_latex(_name_dynamics(row))}"
            name = dynamics if index else escape_latex(titles.get(str(system), str(system)))
            scores = (
                format_score(row, score, scale=PHYSICAL_SCALES.get(score, 1.0)) for score in PHYSICAL_SCORES
            )
            recording = escape_latex(str(row["recording"]))
            body.append(format_cells(name, str(row["d"]), *scores, format_diverged(row, rollouts), recording))
    recordings = join_distinct(row["recording"] for row in rows)
    return format_latex_table(
        head=[
            r"System & $d$ & $\varepsilon_{\mathrm{freq}}$ & $\varepsilon_{q}$ & $\varepsilon_{I}$ & "
            r"$\varepsilon_{\mathrm{AE}}$ & Diverged & Recording \\",
            r" & & (\%) & & $(\times\,\varepsilon_{\mathrm{AE}})$ & $(10^{-4})$ & rollouts & \\",
        ],
        body=body,
        alignment="lccccccl",
        caption=(
            "Free rollouts on the held-out part: error of the free frequency, of the latent state and of the "
            "image over two natural periods, the image's as a multiple of the static error of the "
            f"autoencoder. {recordings.capitalize()} recordings, {describe_runs(rows)} A rollout that "
            "diverges stays in every mean, scored no better than the mean prediction, and is counted over "
            "all scores of the run. The paper's own numbers were measured on its filmed recordings, and are "
            "not comparable with a simulated one."
        ),
        label="tab:physical",
    )


def _name_dynamics(row: Mapping[Any, Any]) -> str:
    """The kind of dynamics, with the names of the settings that are not the default, or the paper."""
    changed = str(row["method"]).removeprefix("LaGSplat").strip()
    return f"{row['dynamics']} {changed}".strip()


def build_guarantee_table(
    runs: Sequence[Mapping[str, Any]], results: Sequence[Mapping[str, Any]]
) -> pd.DataFrame:
    """Build a row for each run with the results of `lagsplat.evaluate.guarantee.measure_guarantee`.

    Raises:
        ValueError: no run.
    """
    if not runs:
        raise ValueError("no learned Lagrangian to check: train a run first")
    rows = [
        {name: run[name] for name in RUN_FIELDS} | dict(result)
        for run, result in zip(runs, results, strict=True)
    ]
    return pd.DataFrame(rows, dtype=object).reindex(columns=[*RUN_FIELDS, *GUARANTEE_FIELDS])
