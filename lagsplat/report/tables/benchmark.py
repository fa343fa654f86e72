"""The benchmark of the pneumatic arms: our runs, the published baselines, and the paper's numbers."""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from lagsplat.baselines.config import BASELINE_TITLES
from lagsplat.evaluate.aggregate import MEAN_IMAGE, MEASURED, SERIES, aggregate, paired_margin
from lagsplat.report.common import table_rows
from lagsplat.report.common.printed_table import (
    Column,
    PrintedTable,
    Row,
    lay_out,
    make_count_column,
    make_number_column,
    make_text_column,
)
from lagsplat.report.common.published_values import list_paper_baselines, list_paper_rows

MARGIN_SCORE = "mse_half_second"
BELOW_MEAN, NEAR_MEAN = "†", "‡"
MARKS = {
    BELOW_MEAN: f"{BELOW_MEAN}: not better than the mean image, by the 95 % interval; no gain is given.",
    NEAR_MEAN: f"{NEAR_MEAN}: less than twice as good as the mean image.",
}
LEAST_GAIN = 0.5  # over the mean image, as a share of its error, of a baseline that has learned to forecast
DEFAULT_DYNAMICS = "default"  # conf/stage2/default.yaml: the dynamics that baselines are compared with
CONSTANT_DYNAMICS = "constant"  # conf/stage2/constant.yaml
BENCHMARK_COLUMNS = (
    *("robot", "method", "dynamics", "d", *MEASURED, "margin", "margin_low", "margin_high", "external_force"),
    *("converged", "over_mean", "diverged", "recording", "profile", "n_seeds", "steps", "frames_seen"),
    *("wall_s", "rollouts", "windows", "source"),
)
MARGIN_COLUMNS = (
    *("robot", "dynamics", "baseline", "score", "value", "low", "high", "relative", "decided", "windows"),
    *("recording", "profile", "n_seeds"),
)


def build_benchmark_rows(
    runs: Sequence[Mapping[str, Any]],
    metrics: Sequence[dict[str, Any]],
    image_models: Sequence[Mapping[str, Any]],
    simple: Sequence[dict[str, Any]],
    baseline_runs: Sequence[Mapping[str, Any]],
    baseline_metrics: Sequence[dict[str, Any]],
) -> list[dict[str, Any]]:
    """Build the rows of `build_rows`, of `build_simple_rows`, and one for each baseline on each recording.

    Every row but ours has ``margin``: how much lower our half-second image error is on the same starts, with
    its 95 % interval over starts (``margin_low``, ``margin_high``) and seeds averaged on both sides. It is
    empty where there is no run of ours on that recording, and where a baseline has not ``converged``, so that
    beating it tells nothing: the 95 % interval of its gain over the mean training image includes zero.
    ``over_mean`` is that gain as a share of the mean image's error.

    Raises:
        ValueError: two models were scored on different starts of one recording.
    """
    ours = {
        (group.system, group.recording, group.profile): variants.get(DEFAULT_DYNAMICS, [])
        for group, variants in table_rows.group_runs(runs, metrics).items()
    }
    rows = table_rows.build_rows(runs, metrics)
    mean_images: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for (group, method), members in table_rows.group_simple(image_models, simple).items():
        key = (group.system, group.recording, group.profile)
        if method == MEAN_IMAGE:
            mean_images[key] = members
        row = table_rows.build_row(aggregate(members), robot=group.system, method=method, **group.place)
        rows.append(row | table_rows.measure_margin(ours.get(key, []), members, MARGIN_SCORE))
    baselines: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for run, scores in zip(baseline_runs, baseline_metrics, strict=True):
        names = tuple(str(run[name]) for name in ("system", "recording", "profile", "baseline"))
        baselines.setdefault(names, []).append(scores)
    for (robot, recording, profile, name), members in baselines.items():
        key, method = (robot, recording, profile), BASELINE_TITLES.get(name, name)
        row = table_rows.build_row(
            aggregate(members), robot=robot, method=method, recording=recording, profile=profile
        )
        beside = compare_with_mean_image(members, mean_images.get(key, []))
        runs_beside = [] if beside["converged"] is False else ours.get(key, [])
        rows.append(row | beside | table_rows.measure_margin(runs_beside, members, MARGIN_SCORE))
    return rows


def compare_with_mean_image(
    members: Sequence[dict[str, Any]], mean_image: Sequence[dict[str, Any]]
) -> dict[str, Any]:
    """Tell if a baseline has ``converged``, and its gain ``over_mean``; see `build_benchmark_rows`.

    Both are None without scores of the mean image. With too few windows for an interval, any gain counts.
    """
    if not mean_image:
        return {"converged": None, "over_mean": None}
    gain = paired_margin(members, mean_image, score=MARGIN_SCORE)
    bound = gain["value"] if gain["low"] is None else gain["low"]
    return {"converged": bound > 0.0, "over_mean": gain["relative"]}


def build_benchmark_table(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Build the table of our rows and the paper's own beside them, robot by robot.

    The columns are `BENCHMARK_COLUMNS`, then ``_low`` and ``_high`` of each metric that has a spread.

    Raises:
        ValueError: no row.
    """
    merged = table_rows.merge_with_published(
        rows, lambda robots: [*list_paper_rows(robots), *list_paper_baselines(robots)]
    )
    return merged.reindex(columns=[*BENCHMARK_COLUMNS, *table_rows.list_spread_columns(merged, MEASURED)])


def build_margin_table(runs: Sequence[Mapping[str, Any]], metrics: Sequence[dict[str, Any]]) -> pd.DataFrame:
    """Build a row for each score of each variant that has a constant-coefficient run beside it.

    ``runs`` and ``metrics`` as in `group_runs`. ``value`` is how much lower the variant errs, with its
    interval over distinct windows, seeds averaged on both sides; ``decided`` says that the interval excludes
    zero. Without a constant-coefficient run the table is empty.
    """
    rows: list[dict[str, Any]] = []
    for group, variants in table_rows.group_runs(runs, metrics).items():
        constant = variants.pop(CONSTANT_DYNAMICS, [])
        for name, members in variants.items() if constant else ():
            for score, (block, key) in SERIES.items():
                if not all(key in run[block] for run in [*members, *constant]):
                    continue  # without a natural period nothing was scored over two of them
                margin = paired_margin(members, constant, score=score)
                names = {"robot": group.system, "dynamics": name, "baseline": CONSTANT_DYNAMICS}
                rows.append({**names, **margin, **group.place, "n_seeds": len(members)})
    return pd.DataFrame(rows, columns=list(MARGIN_COLUMNS))


def lay_out_margins(table: pd.DataFrame, *, titles: Mapping[str, str]) -> list[PrintedTable]:
    """Lay out the table of `build_margin_table`; ``titles`` gives the name of each system."""
    scores = {"mse_half_second": "half a second", "image_mse": "two periods"}
    columns = [
        make_text_column("Dynamics", lambda row: row["dynamics"]),
        make_text_column("Forecast over", lambda row: scores[row["score"]]),
        make_number_column(
            *("value", "Gain", "(10⁻³)"),
            scale=1e3,
            note="Gain: how much lower the image error is on the same windows, with its 95 % interval.",
        ),
        make_number_column("relative", "Relative", "gain (%)", scale=1e2, digits=2),
        make_text_column("Decided", lambda row: "yes" if row["decided"] else "no"),
        make_count_column("windows", "Windows"),
    ]
    return [
        lay_out(
            table.rename(columns={"low": "value_low", "high": "value_high"}),
            columns,
            label="tab:margins",
            lead="What forms of the dynamics gain over constant coefficients.",
            caption="Held-out part, seeds averaged on both sides; decided: the interval excludes zero.",
            block=lambda row: table_rows.name_block(row, titles, key="robot"),
        )
    ]


def lay_out_benchmark(table: pd.DataFrame, *, titles: Mapping[str, str]) -> list[PrintedTable]:
    """Lay out the table of `build_benchmark_table`: the scores, and what else is known of each method.

    ``titles`` gives the name of each robot.
    """
    shared: dict[str, Any] = {
        "block": lambda row: table_rows.name_block(row, titles, key="robot") + _tell_windows(row, table),
        "compared": ("robot", "recording"),
        "caption": f"Held-out part of each recording. {table_rows.describe_runs(table)}",
    }
    marks = {_mark_baseline(row) for row in table.to_dict("records")}
    note = " ".join(text for mark, text in MARKS.items() if mark in marks)
    method = make_text_column("Method", _name_method, note=note)
    scores, rest = [method, *_list_score_columns()], [method, *_list_other_columns()]
    lead = "Forecasts of the pneumatic arms"
    paper = [table_rows.tell_of_paper(table, "The paper's numbers are of its own films.")]
    return [
        lay_out(table, scores, label="tab:krauss", lead=f"{lead}.", notes=paper, **shared),
        lay_out(table, rest, label="tab:krauss-rest", lead=f"{lead}: models and forces.", **shared),
    ]


def _tell_windows(row: Row, table: pd.DataFrame) -> str:
    """How many windows of half a second that do not overlap a recording has, for the heading of its block."""
    same = table[(table["robot"] == row["robot"]) & (table["recording"] == row["recording"])]
    found = same.get("windows", pd.Series(dtype=float)).dropna()  # earlier campaigns have none
    return "" if found.empty else f", {found.iloc[0]:.0f} distinct windows"


def _list_score_columns() -> list[Column]:
    latent = make_number_column(
        *("latent_nrmse", "Latent", "NRMSE (%)"),
        scale=1e2,
        note="Latent: over two natural periods; a baseline's is of its own latents, so not compared.",
    )
    return [
        make_count_column("d", "Dim."),
        make_number_column(
            *("mse_half_second", "MSE 0.5 s", "(10⁻³)"),
            scale=1e3,
            best="lowest",
            note="MSE 0.5 s: image error of half-second forecasts, the given state counted as the first.",
        ),
        make_number_column(
            *("margin", "Our gain", "(10⁻³)"),
            scale=1e3,
            note="Our gain: how much lower LaGSplat's is on the same starts, means over seeds, with the 95 % "
            "interval over windows.",
        ),
        make_number_column(
            *("frequency_error", "Frequency", "error (%)"),
            scale=1e2,
            best="lowest",
            note="Frequency: 100 stands for no oscillation.",
        ),
        latent._replace(rank=_rank_latent_error),
        table_rows.make_diverged_column(),
    ]


def _rank_latent_error(row: Row) -> float | None:
    is_ours = row["method"] not in BASELINE_TITLES.values()
    return row["latent_nrmse"] if is_ours else None


def _list_other_columns() -> list[Column]:
    floor = "AE floor: image error of the autoencoder."
    return [
        make_text_column("Dynamics", lambda row: row["dynamics"]),
        make_number_column("ae_floor", "AE floor", "(10⁻⁵)", scale=1e5, best="lowest", note=floor),
        make_number_column(
            *("mse_ahead", "MSE 0.5 s", "from next (10⁻³)"),
            scale=1e3,
            best="lowest",
            note="From next: without the given state.",
        ),
        make_number_column(
            *("image_ratio", "Image error", "/ AE floor"), note="Image error: over two natural periods."
        ),
        make_text_column(
            "External force",
            lambda row: row["external_force"],
            note="External force: where a force given in the image can act.",
        ),
        make_number_column(
            *("frames_seen", "Frames", "(10³)"),
            scale=1e-3,
            note="Frames: seen while the image model, or a baseline, was trained.",
        ),
        make_number_column(
            *("wall_s", "Time", "(min)"),
            scale=1 / 60,
            digits=2,
            note="Time: of all training, on the clock; our image model takes all cores, a baseline one.",
        ),
    ]


def _name_method(row: Row) -> str:
    return f"{str(row['method']).removesuffix(' (paper)')} {_mark_baseline(row)}".rstrip()


def _mark_baseline(row: Row) -> str:
    if row.get("converged") is False:
        return BELOW_MEAN
    gain = row.get("over_mean")
    return NEAR_MEAN if gain is not None and gain < LEAST_GAIN else ""
