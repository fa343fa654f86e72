"""Tables of the learned physics: against the truth, by form of the mass, beside the paper, guaranteed."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import pandas as pd

from lagsplat.evaluate.aggregate import aggregate
from lagsplat.evaluate.truth import AT_REST, LINEARISED, ComparedQuantity
from lagsplat.report.common import table_rows
from lagsplat.report.common.formatting import format_interval, join_distinct
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
)
from lagsplat.report.common.published_values import PAPER, RECORDING

TRUTH_COLUMNS = ("system", "method", *ComparedQuantity._fields, "learned", "truth", "error")
TRUTH_CONTEXT = ("low", "high", "extrapolated", "encoded", "residual", "recording", "profile", "n_seeds")

OF_INTERVALS = (
    "Interval: over blocks of the training part, for laws fitted by likelihood; in italics where its ends "
    "differ by a factor of two; e: extrapolated to a rest state that the recording hardly visits."
)
OF_REST = (
    "Error: relative, median of the seeds' own, so it may exceed that of the median; of an equilibrium a "
    "share of the motion's rms."
)
OF_MAP = "Map: residual of the map by which a latent is read in true coordinates, as such a share."

MASS_TITLES = {"constant_mass": "constant", "induced_mass": "induced by the decoder"}
LEARNED_MASS = "learned"
CONSTANT_MASS = "constant_mass"
INERTIA_MEASURES = ("state_dependence", "span", "condition_median", "condition_max")
MASS_SCORES = ("mse_half_second", "frequency_error", "latent_nrmse")
MASS_COLUMNS = (
    *("robot", "mass", "d", *MASS_SCORES, "margin", "margin_low", "margin_high", *INERTIA_MEASURES),
    *("ae_floor", "diverged", "recording", "profile", "n_seeds"),
)
# Half-second error and frequency error of the two-segment arm; of the constant mass the first alone.
PAPER_MASSES = {
    LEARNED_MASS: {"mse_half_second": 0.769e-3, "frequency_error": 0.057},
    MASS_TITLES["induced_mass"]: {"mse_half_second": 1.33e-3, "frequency_error": 0.069},
    MASS_TITLES["constant_mass"]: {"mse_half_second": 4.8e-3},
}
PAPER_ROBOT = "krauss_2seg"

PHYSICAL_SCORES = ("frequency_error", "latent_nrmse", "image_ratio", "ae_floor")
PHYSICAL_COLUMNS = (
    *("system", "d", *PHYSICAL_SCORES, "diverged", "recording", "profile", "n_seeds", "rollouts", "method"),
    "long_windows",
)

RECIPE_SCORES = ("frequency_error", "latent_nrmse", "image_ratio", "mse_half_second")
RECIPE_COLUMNS = (
    *("robot", "method", "d", *RECIPE_SCORES, "wall_s", "diverged", "rollouts"),
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
    and the largest value, as ``error_low`` and ``error_high``; ``error`` is the median of the seeds' own
    errors. ``n_seeds`` counts the seeds in which the quantity was found. Dynamics other than the default are
    named with the method. A recording without truth gives no row.

    Raises:
        ValueError: no recording has a truth.
    """
    rows: list[dict[str, Any]] = []
    for group, variants in table_rows.group_runs(runs, metrics).items():
        for stage2, members in variants.items():
            seeds = [run["truth"]["rows"] for run in members if "truth" in run]
            method = "LaGSplat" + table_rows.name_changes(group.stage1, stage2)
            quantities: dict[ComparedQuantity, list[dict[str, Any]]] = {}
            for measured in itertools.chain.from_iterable(seeds):
                of = ComparedQuantity(*(measured[name] for name in ComparedQuantity._fields))
                quantities.setdefault(of, []).append(measured)
            for of, same in quantities.items():
                row: dict[str, Any] = {"system": group.system, "method": method, **group.place}
                row |= of._asdict()
                for name in ("learned", "truth", "error", "low", "high", "encoded", "residual"):
                    row[name] = table_rows.take_median(measured.get(name) for measured in same)
                told = {measured.get("extrapolated") for measured in same} - {None}
                row["extrapolated"] = any(told) if told else None
                for name in ("learned", "error"):
                    values = [measured[name] for measured in same if measured.get(name) is not None]
                    if len(set(values)) > 1:
                        row |= {f"{name}_low": min(values), f"{name}_high": max(values)}
                found = sum(measured["learned"] is not None for measured in same)
                rows.append(row | {"n_seeds": found})
    if not rows:
        raise ValueError("no run has a truth to compare with: evaluate one of a simulated recording")
    frame = pd.DataFrame(rows, dtype=object)
    spread = table_rows.list_spread_columns(frame, ["learned", "error"])
    return frame.reindex(columns=[*TRUTH_COLUMNS, *TRUTH_CONTEXT, *spread])


def lay_out_truth(table: pd.DataFrame, *, titles: Mapping[str, str]) -> list[PrintedTable]:
    """Lay out the table of `build_truth_table`: the linearised laws, then every quantity.

    ``titles`` gives the name of each system.
    """
    is_law = (table["source"] == LINEARISED) & (table["state"] == AT_REST)
    # a single mode needs no number
    table = table.assign(mode=table["mode"].where(table.groupby("system")["mode"].transform("nunique") > 1))
    seeds = " or ".join(sorted(set(table["n_seeds"].astype(str))))
    settings = (
        f"Profile {join_distinct(table['profile'])}; medians over seeds ({seeds}), brackets: their range."
    )
    columns = [
        make_text_column("Quantity", lambda row: _name_quantity(row, _name_source(row))),
        make_number_column("learned", "Learned", digits=4),
        Column("90 % interval", _write_known_range, note=OF_INTERVALS),
        make_number_column("truth", "Truth", digits=4),
        make_number_column("error", "Error", "(%)", scale=100.0, note=OF_REST),
    ]
    law = make_text_column("Quantity", lambda row: _name_quantity(row, ""))
    more = [
        make_number_column(
            "encoded", "Encoded", digits=4, note="Encoded: read from the encoded motion by the same fit."
        ),
        make_number_column("residual", "Map", "(%)", scale=100.0, note=OF_MAP),
    ]
    shared: dict[str, Any] = {"block": lambda row: table_rows.name_block(row, titles)}
    return [
        lay_out(
            *(table[is_law] if is_law.any() else table, [law, *columns[1:]]),
            label="tab:truth",
            lead="Learned laws against the truth, which no training saw.",
            caption=f"Linearised at rest, against the eigenvalues of the true equations. {settings}",
            **shared,
        ),
        lay_out(
            *(table, [*columns, *more]),
            label="tab:truth-rest",
            lead="Learned physics against the truth: every quantity.",
            caption=f"Free rollouts are compared with the true motion over the same frames. {settings}",
            **shared,
        ),
    ]


def _name_quantity(row: Row, source: str) -> str:
    """As ``decay rate 2, law at rest [1/s]``."""
    text = row["quantity"] + ("" if pd.isna(row["mode"]) else f" {row['mode']:.0f}") + source
    text += "" if pd.isna(row["unit"]) else f" [{row['unit']}]"
    return str(text + row["method"].removeprefix("LaGSplat"))


def _name_source(row: Row) -> str:
    if not pd.isna(row["coordinate"]):
        return f", {row['coordinate']}"
    return f", {row['source']}" if pd.isna(row["state"]) else f", law {row['state']}"


UNDETERMINED = 2.0  # ratio of the ends of an interval, from which a number is not determined


def _write_known_range(row: Row) -> Cell:
    """An interval; in italics where its ends differ by a factor of two, a dash where there is none."""
    low, high = row.get("low"), row.get("high")
    if low is None or high is None or pd.isna(low) or pd.isna(high):
        return Cell(DASH)
    _, lower, upper = format_interval(low, low, high)
    undetermined = low >= 0.0 and high > 0.0 and high > UNDETERMINED * low
    mark = "e" if row.get("extrapolated") is True else ""
    return Cell(f"{lower} to {upper}", mark=mark, italic=undetermined)


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
            paper = {"robot": group.system, "d": 4, **PAPER}
            rows += [{**paper, "mass": f"{name} (paper)", **scores} for name, scores in PAPER_MASSES.items()]
    return rows


def build_mass_table(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Build the table of the rows of `build_mass_rows`: `MASS_COLUMNS`, then the spread of each score."""
    return _build_scores_table(rows, MASS_COLUMNS, MASS_SCORES)


def build_recipes_table(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Build the table of rows of `build_rows` that differ in the settings of both stages."""
    return _build_scores_table(rows, RECIPE_COLUMNS, RECIPE_SCORES)


def _build_scores_table(
    rows: Sequence[Mapping[str, Any]], columns: Sequence[str], scores: Sequence[str]
) -> pd.DataFrame:
    frame = pd.DataFrame(list(rows), dtype=object)
    return frame.reindex(columns=[*columns, *table_rows.list_spread_columns(frame, scores)])


def lay_out_mass(table: pd.DataFrame, *, titles: Mapping[str, str]) -> list[PrintedTable]:
    """Lay out the table of `build_mass_table`: scores, then matrices; ``titles`` names each robot.

    Source: paper, "Decoder-induced inertia".
    """
    mass = make_text_column("Mass", lambda row: row["mass"].removesuffix(" (paper)"))
    gain = make_number_column(
        *("margin", "Gain", "(10⁻³)"),
        scale=1e3,
        note="Gain: how much lower the error over 0.5 s is than with the constant mass on the same starts, "
        "with its 95 % interval over them.",
    )
    matrices = [
        make_number_column(
            *("state_dependence", "State", "dependence (%)"),
            scale=100.0,
            least=0.01,
            note="State dependence: rms deviation of the matrix from its mean, as a share of its rms.",
        ),
        make_number_column(
            "span", "Span", note="Span: largest over smallest eigenvalue relative to the mean."
        ),
        make_number_column("condition_median", "median", over="Condition number"),
        make_number_column("condition_max", "largest", over="Condition number"),
        make_number_column(
            *("ae_floor", "AE floor", "(10⁻⁵)"), scale=1e5, note="AE floor: image error of the autoencoder."
        ),
    ]
    shared: dict[str, Any] = {
        "block": lambda row: table_rows.name_block(row, titles, key="robot"),
        "compared": ("robot", "recording"),
        "caption": f"Held-out part of each recording. {table_rows.describe_runs(table)}",
    }
    return [
        lay_out(
            *(table, [mass, _make_error_column(), gain, *_make_rollout_columns()]),
            label="tab:mass",
            lead="Forms of the mass over one frozen autoencoder.",
            notes=[table_rows.tell_of_paper(table, "The paper's numbers are of its own film.")],
            **shared,
        ),
        lay_out(
            *(table[table["recording"] != RECORDING], [mass, *matrices]),
            label="tab:mass-rest",
            lead="Forms of the mass: the matrices along the trajectory.",
            **shared,
        ),
    ]


def lay_out_recipes(table: pd.DataFrame, *, titles: Mapping[str, str]) -> list[PrintedTable]:
    """Lay out the table of `build_recipes_table`; ``titles`` gives the name of each robot."""

    def name_settings(row: Row) -> str:
        return row["method"].removeprefix("LaGSplat").strip(" ()") or "default"

    columns = [
        make_text_column("Settings", name_settings),
        *_make_rollout_columns(),
        _make_ratio_column(),
        _make_error_column(),
        make_number_column("wall_s", "Time", "(min)", scale=1.0 / 60.0, digits=2),
        table_rows.make_diverged_column(),
    ]
    return [
        lay_out(
            table,
            columns,
            label="tab:recipes",
            lead="Settings of both stages over the same recordings.",
            caption=f"Scores as in the table of free rollouts. {table_rows.describe_runs(table)}",
            block=lambda row: table_rows.name_block(row, titles, key="robot"),
            compared=("robot", "recording"),
            notes=[
                "One name is that of stage 2 with the default image model, two are those of both "
                "stages. Paper: "
                "the paper's values; upstream: those of its published code. Time: of both stages."
            ],
        )
    ]


def _make_error_column() -> Column:
    return make_number_column("mse_half_second", "MSE 0.5 s", "(10⁻³)", scale=1e3, best="lowest")


def _make_ratio_column() -> Column:
    note = "Image error: over two natural periods, over the autoencoder's static error (AE floor)."
    return make_number_column("image_ratio", "Image error", "/ AE floor", note=note)


def _make_rollout_columns() -> list[Column]:
    return [
        make_number_column("frequency_error", "Frequency", "error (%)", scale=1e2, best="lowest"),
        make_number_column("latent_nrmse", "Latent", "NRMSE (%)", scale=1e2, best="lowest"),
    ]


def build_physical_table(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Build the table of the rows and the paper's own, system by system; see `build_rows`.

    The columns are `PHYSICAL_COLUMNS`, then ``_low`` and ``_high`` of each score that has a spread.

    Raises:
        ValueError: no row.
    """
    frame = table_rows.merge_with_published(rows).rename(columns={"robot": "system"})
    spread = table_rows.list_spread_columns(frame, PHYSICAL_SCORES)
    return frame.reindex(columns=[*PHYSICAL_COLUMNS, *spread])


def lay_out_physical(table: pd.DataFrame, *, titles: Mapping[str, str]) -> list[PrintedTable]:
    """Lay out the table of `build_physical_table`; ``titles`` gives the name of each system.

    Source: paper, Table "Free rollouts".
    """
    columns = [
        make_text_column("Method", lambda row: str(row["method"]).removesuffix(" (paper)")),
        make_count_column("d", "Dim."),
        *_make_rollout_columns(),
        _make_ratio_column(),
        make_number_column("ae_floor", "AE floor", "(10⁻⁴)", scale=1e4),
        make_count_column("long_windows", "Windows", note="Windows: of two periods that do not overlap."),
        table_rows.make_diverged_column(),
    ]
    return [
        lay_out(
            table,
            columns,
            label="tab:physical",
            lead="Free rollouts over two natural periods of the held-out part.",
            caption=table_rows.describe_runs(table),
            block=lambda row: table_rows.name_block(row, titles),
            notes=["Films and simulations are different recordings, and cannot be compared."]
            if table["recording"].nunique() > 1
            else [],
        )
    ]


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


def lay_out_guarantee(table: pd.DataFrame, *, titles: Mapping[str, str]) -> list[PrintedTable]:
    """Lay out the table of `build_guarantee_table`; ``titles`` gives the name of each system."""

    def count(settled: str, diverged: str) -> Callable[[Row], str | None]:
        def write(row: Row) -> str | None:
            if pd.isna(row[settled]):
                return None
            return f"{int(row[settled])}/{int(row['starts'])}, {int(row[diverged])}"

        return write

    columns = [
        make_text_column("Law", lambda row: f"{row['stage1']}-{row['ae']}, {row['stage2']}-{row['seed']}"),
        make_text_column("Holds", lambda row: "yes" if row["holds"] else row["reason"], wrap_em=9),
        make_number_column(
            *("rise", "Rise", "(%)"),
            scale=1e2,
            note="Rise: of the energy above an earlier value, over that at the start; integration alone adds "
            "some, which halving the step shows.",
        ),
        make_number_column("rise_at_half_step", "at half", "the step (%)", scale=1e2),
        make_text_column(
            "Free",
            count("free_settled", "free_diverged"),
            note="Free, held: starts that came to rest, and those that diverged, without and under a force.",
        ),
        make_number_column("free_time_s", "within", "(s)"),
        make_text_column("Held", count("held_settled", "held_diverged")),
        make_number_column("held_time_s", "within", "(s)"),
        make_number_column(
            *("held_force_error", "Force", "error (%)"),
            scale=1e2,
            note="Force error: of the potential's force at rest against the held one.",
        ),
    ]
    far = " or ".join(sorted({f"{value:g}" for value in table["far"].dropna()}))
    return [
        lay_out(
            table,
            columns,
            label="tab:guarantee",
            lead="Whether trained laws can be driven away.",
            caption=f"From states {far} times as far out as the data." if far else "",
            block=lambda row: table_rows.name_block(row, titles),
        )
    ]
