"""Tables of the learned physics: against the truth, by form of the mass, beside the paper, guaranteed."""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from lagsplat.evaluate.aggregate import aggregate
from lagsplat.report.common import table_rows
from lagsplat.report.common.formatting import (
    escape_latex,
    format_cells,
    format_digits,
    format_grouped_table,
    format_latex_number,
    format_latex_table,
    join_distinct,
)
from lagsplat.report.common.published_values import RECORDING

TRUTH_COLUMNS = ("system", "quantity", "learned", "truth", "error")
TRUTH_CONTEXT = ("low", "high", "extrapolated", "encoded", "residual", "recording", "profile", "n_seeds")

MASS_TITLES = {"constant_mass": "constant", "induced_mass": "induced by the decoder"}
LEARNED_MASS = "learned"
CONSTANT_MASS = "constant_mass"
INERTIA_MEASURES = ("state_dependence", "span", "condition_median", "condition_max")
MASS_SCORES = ("mse_half_second", "frequency_error", "latent_nrmse")
MASS_COLUMNS = (
    *("robot", "mass", "d", *MASS_SCORES, "margin", "margin_low", "margin_high", *INERTIA_MEASURES),
    *("ae_floor", "diverged", "recording", "profile", "n_seeds"),
)
MASS_SCALES = {
    **{"mse_half_second": 1e3, "margin": 1e3, "frequency_error": 1e2, "latent_nrmse": 1.0},
    **{"state_dependence": 1e2, "span": 1.0},
}
# Half-second error and frequency error of the two-segment arm; of the constant mass the first alone.
PAPER_MASSES = {
    LEARNED_MASS: {"mse_half_second": 0.769e-3, "frequency_error": 0.057},
    MASS_TITLES["induced_mass"]: {"mse_half_second": 1.33e-3, "frequency_error": 0.069},
    MASS_TITLES["constant_mass"]: {"mse_half_second": 4.8e-3},
}
PAPER_ROBOT = "krauss_2seg"

PHYSICAL_SCALES = {"frequency_error": 1e2, "latent_nrmse": 1.0, "image_ratio": 1.0, "ae_floor": 1e4}
PHYSICAL_COLUMNS = ("system", "d", *PHYSICAL_SCALES, "diverged", "recording", "profile", "n_seeds")

RECIPE_SCALES = {"frequency_error": 1e2, "latent_nrmse": 1.0, "image_ratio": 1.0, "mse_half_second": 1e3}
RECIPE_COLUMNS = (
    *("robot", "method", "d", *RECIPE_SCALES, "wall_s", "diverged", "rollouts"),
    *("recording", "profile", "n_seeds"),
)

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
    for group, variants in table_rows.group_runs(runs, metrics).items():
        for stage2, members in variants.items():
            seeds = [run["truth"]["rows"] for run in members if "truth" in run]
            changed = table_rows.name_changes(group.stage1, stage2)
            for quantity in dict.fromkeys(row["quantity"] for seed in seeds for row in seed):
                same = [row for seed in seeds for row in seed if row["quantity"] == quantity]
                row: dict[str, Any] = {"system": group.system, "quantity": quantity + changed, **group.place}
                for name in ("learned", "truth", "error", "low", "high", "encoded", "residual"):
                    row[name] = table_rows.take_median(measured.get(name) for measured in same)
                told = {measured.get("extrapolated") for measured in same} - {None}
                row["extrapolated"] = any(told) if told else None
                learned = {measured["learned"] for measured in same} - {None}
                if len(learned) > 1:
                    row |= {"learned_low": min(learned), "learned_high": max(learned)}
                rows.append(row | {"n_seeds": len(seeds)})
    if not rows:
        raise ValueError("no run has a truth to compare with: evaluate one of a simulated recording")
    frame = pd.DataFrame(rows, dtype=object)
    spread = table_rows.list_spread_columns(frame, ["learned"])
    return frame.reindex(columns=[*TRUTH_COLUMNS, *TRUTH_CONTEXT, *spread])


def format_truth_latex(table: pd.DataFrame, *, titles: Mapping[str, str]) -> str:
    """Format the table of `build_truth_table` in LaTeX; ``titles`` gives the name of each system."""

    def format_row(row: Mapping[Any, Any]) -> str:
        return format_cells(
            escape_latex(str(row["quantity"])),
            table_rows.format_score(row, "learned"),
            format_known_range(row.get("low"), row.get("high"))
            + (r"\textsuperscript{e}" if row.get("extrapolated") else ""),
            *(table_rows.format_score(row, name) for name in ("truth", "encoded")),
            *(table_rows.format_score(row, name, scale=100.0) for name in ("error", "residual")),
        )

    seeds = " or ".join(sorted(set(table["n_seeds"].astype(str))))
    brackets = " Brackets: range over seeds." if "learned_low" in table else ""
    return format_grouped_table(
        table,
        by="system",
        titles=titles,
        row=format_row,
        head=[r"Quantity & Learned & 90\,\% interval & Truth & Encoded & Error (\%) & Map (\%) \\"],
        alignment="lcccccc",
        caption=(
            "Learned physics of the simulated systems against their truth, which no training saw; profile "
            f"{join_distinct(table['profile'])}; medians over seeds ({seeds}).{brackets} A free rollout is "
            "compared with the true motion over the same frames, both measured by the same fit, which also "
            "reads the encoded motion; the linearised law with the eigenvalues of the true equations. Errors "
            "are relative; that of an equilibrium, and the residual of the map by which a latent is read in "
            "true coordinates, are fractions of the motion's rms. Intervals come from blocks of the training "
            "part, for laws fitted by likelihood; what is in italics the recording does not determine, and "
            "what has an e is extrapolated to a rest state that it hardly visits, of which intervals know "
            "nothing."
        ),
        label="tab:truth",
    )


UNDETERMINED = 2.0  # ratio of the ends of an interval, from which a number is not determined


def format_known_range(low: float | None, high: float | None) -> str:
    """Format an interval; in italics where its ends differ by a factor of two, a dash where there is none."""
    if low is None or high is None or pd.isna(low) or pd.isna(high):
        return "--"
    text = f"{format_digits(low)} to {format_digits(high)}"
    positive = low >= 0.0 and high > 0.0
    return rf"\emph{{{text}}}" if positive and high > UNDETERMINED * low else text


def build_mass_rows(
    runs: Sequence[Mapping[str, Any]], metrics: Sequence[dict[str, Any]]
) -> list[dict[str, Any]]:
    """Build a row for each form of the mass on each recording, and the paper's own for its robot.

    ``margin`` is how much lower the half-second image error is than with the constant mass on the same
    starts, with its 95 % interval over them. The numbers of `lagsplat.evaluate.truth.inertia_along` are
    medians over seeds.
    """
    rows: list[dict[str, Any]] = []
    for group, variants in table_rows.group_runs(runs, metrics).items():
        constant = variants.get(CONSTANT_MASS, [])
        for name, members in variants.items():
            row = table_rows.build_row(
                aggregate(members), robot=group.system, method="LaGSplat", **group.place
            )
            row["mass"] = MASS_TITLES.get(name, LEARNED_MASS)
            for key in INERTIA_MEASURES:
                row[key] = table_rows.take_median(run["inertia"][key] for run in members)
            if constant and name != CONSTANT_MASS:
                row |= table_rows.measure_margin(members, constant, "mse_half_second")
            rows.append(row)
        if group.system == PAPER_ROBOT:
            paper = {"robot": group.system, "d": 4, "recording": RECORDING, "profile": "the paper's"}
            rows += [{**paper, "mass": f"{name} (paper)", **scores} for name, scores in PAPER_MASSES.items()]
    return rows


def format_mass_latex(rows: Sequence[Mapping[str, Any]], *, titles: Mapping[str, str]) -> str:
    """Format the rows of `build_mass_rows` in LaTeX; ``titles`` gives the heading of each robot's block.

    Source: paper, "Decoder-induced inertia".
    """

    def format_row(row: Mapping[Any, Any]) -> str:
        median, largest = (format_latex_number(row[name]) for name in ("condition_median", "condition_max"))
        return format_cells(
            escape_latex(str(row["mass"])),
            *table_rows.format_scores(row, MASS_SCALES),
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


def format_recipes_latex(rows: Sequence[Mapping[str, Any]], *, titles: Mapping[str, str]) -> str:
    """Format rows of `build_rows` that differ in the settings of both stages, system by system, in LaTeX."""

    def format_row(row: Mapping[Any, Any]) -> str:
        name = str(row["method"]).removeprefix("LaGSplat").strip(" ()") or "default"
        return format_cells(
            escape_latex(name),
            *table_rows.format_scores(row, RECIPE_SCALES),
            table_rows.format_score(row, "wall_s", scale=1.0 / 60.0),
            table_rows.format_diverged(row),
        )

    frame = pd.DataFrame(list(rows), dtype=object)
    return format_grouped_table(
        frame,
        by="robot",
        titles=titles,
        row=format_row,
        head=[
            r"Settings & $\varepsilon_{\mathrm{freq}}$ & $\varepsilon_{q}$ & $\varepsilon_{I}$ & "
            r"MSE 0.5\,s & Time & Diverged \\",
            r" & (\%) & & $(\times\,\varepsilon_{\mathrm{AE}})$ & $(10^{-3})$ & (min) & rollouts \\",
        ],
        alignment="lcccccc",
        caption=(
            "Settings of stage 1 and stage 2 over the same recordings: one name is that of stage 2 with "
            "the default image model, two are those of both stages; paper: the paper's values, upstream: "
            f"those of its published code. {join_distinct(frame['recording']).capitalize()} recordings, "
            f"profile {join_distinct(frame['profile'])}; scores as in the table of free rollouts, medians "
            "over seeds. Time is that of both stages."
        ),
        label="tab:recipes",
    )


def build_physical_table(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Build the table of our rows and the paper's own, system by system; the rows are those of `build_rows`.

    The columns are `PHYSICAL_COLUMNS`, then ``dynamics`` if there are any but the default, then ``_low`` and
    ``_high`` of each score that has a spread.

    Raises:
        ValueError: no row.
    """
    frame = table_rows.merge_with_published(rows).rename(columns={"robot": "system"})
    several = {row["method"] for row in rows} - {"LaGSplat"}
    frame["dynamics"] = [_name_dynamics(row) for row in frame.to_dict("records")]
    spread = table_rows.list_spread_columns(frame, list(PHYSICAL_SCALES))
    return frame.reindex(columns=[*PHYSICAL_COLUMNS, *(["dynamics"] if several else []), *spread])


def format_physical_latex(rows: Sequence[Mapping[str, Any]], *, titles: Mapping[str, str]) -> str:
    """Format the rows of `build_physical_table` in LaTeX; ``titles`` gives the name of each system.

    Source: paper, Table "Free rollouts".
    """
    body = []
    for system, block in table_rows.merge_with_published(rows).groupby("robot", sort=False):
        body.append(r"\midrule")
        for index, row in enumerate(block.to_dict("records")):
            dynamics = rf"\quad {escape_latex(_name_dynamics(row))}"
            name = dynamics if index else escape_latex(titles.get(str(system), str(system)))
            scores = table_rows.format_scores(row, PHYSICAL_SCALES)
            diverged, recording = table_rows.format_diverged(row), escape_latex(str(row["recording"]))
            body.append(format_cells(name, str(row["d"]), *scores, diverged, recording))
    recordings = join_distinct(row["recording"] for row in rows).capitalize()
    described = table_rows.describe_runs(rows)
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
            f"autoencoder. {recordings} recordings, {described} A rollout that "
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
    rows = [{**run, **result} for run, result in zip(runs, results, strict=True)]
    return table_rows.build_table(rows, [*RUN_FIELDS, *GUARANTEE_FIELDS])
