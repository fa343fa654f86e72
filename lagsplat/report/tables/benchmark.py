"""The benchmark of the pneumatic arms: our runs, the published baselines, and the paper's numbers."""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from lagsplat.baselines.config import BASELINE_TITLES
from lagsplat.evaluate.aggregate import MEASURED, SERIES, aggregate, paired_margin
from lagsplat.report.common import table_rows
from lagsplat.report.common.formatting import escape_latex, format_cells, format_grouped_table
from lagsplat.report.common.published_values import list_paper_baselines, list_paper_rows

MARGIN_SCORE = "mse_half_second"
DEFAULT_DYNAMICS = "default"  # conf/stage2/default.yaml: the dynamics that baselines are compared with
CONSTANT_DYNAMICS = "constant"  # conf/stage2/constant.yaml
BENCHMARK_COLUMNS = (
    *("robot", "method", "dynamics", "d", *MEASURED, "margin", "margin_low", "margin_high", "external_force"),
    *("diverged", "recording", "profile", "n_seeds", "steps", "frames_seen", "wall_s"),
)
BENCHMARK_SCALES = {
    **{"ae_floor": 1e5, "mse_half_second": 1e3, "mse_ahead": 1e3, "frequency_error": 1e2},
    **{"latent_nrmse": 1.0, "image_ratio": 1.0, "margin": 1e3},
}
MARGIN_COLUMNS = (
    *("robot", "dynamics", "baseline", "score", "value", "low", "high", "relative", "decided", "windows"),
    *("recording", "profile", "n_seeds"),
)


def build_benchmark_rows(
    runs: Sequence[Mapping[str, Any]],
    metrics: Sequence[dict[str, Any]],
    baseline_runs: Sequence[Mapping[str, Any]],
    baseline_metrics: Sequence[dict[str, Any]],
) -> list[dict[str, Any]]:
    """Build the rows of `build_rows`, and one for each baseline on each recording.

    A baseline's row has ``margin``: how much lower our half-second image error is on the same starts, with
    its 95 % interval over starts (``margin_low``, ``margin_high``) and seeds averaged on both sides. It is
    empty where there is no run of ours on that recording.

    Raises:
        ValueError: a baseline and a run of ours were scored on different starts of one recording.
    """
    ours = {
        (group.system, group.recording, group.profile): variants.get(DEFAULT_DYNAMICS, [])
        for group, variants in table_rows.group_runs(runs, metrics).items()
    }
    baselines: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for run, scores in zip(baseline_runs, baseline_metrics, strict=True):
        key = tuple(str(run[name]) for name in ("system", "recording", "profile", "baseline"))
        baselines.setdefault(key, []).append(scores)
    rows = table_rows.build_rows(runs, metrics)
    for (robot, recording, profile, name), members in baselines.items():
        names = {"robot": robot, "recording": recording, "profile": profile}
        row = table_rows.build_row(aggregate(members), method=BASELINE_TITLES.get(name, name), **names)
        beside = ours.get((robot, recording, profile), [])
        rows.append(row | table_rows.measure_margin(beside, members, MARGIN_SCORE))
    return rows


def build_benchmark_table(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Build the table of our rows and the paper's own beside them, robot by robot.

    The columns are `BENCHMARK_COLUMNS`, then ``_low`` and ``_high`` of each metric that has a spread.

    Raises:
        ValueError: no row.
    """
    merged = _merge(rows)
    return merged.reindex(columns=[*BENCHMARK_COLUMNS, *table_rows.list_spread_columns(merged, MEASURED)])


def _merge(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    return table_rows.merge_with_published(
        rows, lambda robots: [*list_paper_rows(robots), *list_paper_baselines(robots)]
    )


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


def format_benchmark_latex(rows: Sequence[Mapping[str, Any]], *, titles: Mapping[str, str]) -> str:
    """Format the benchmark in LaTeX; ``titles`` gives the heading of each robot's block.

    The caption names the recordings, the profiles and what the brackets are.
    """

    def format_row(row: Mapping[Any, Any]) -> str:
        steps = row.get("steps")
        return format_cells(
            escape_latex(str(row["method"])),
            escape_latex(str(row["dynamics"])),
            str(row["d"]),
            *table_rows.format_scores(row, BENCHMARK_SCALES),
            escape_latex(str(row["external_force"])),
            table_rows.format_diverged(row),
            "--" if steps is None or pd.isna(steps) else f"{int(steps)}",
            escape_latex(str(row["recording"])),
        )

    recordings = " and ".join(sorted({_name_recording(row) for row in rows}))
    described = table_rows.describe_runs(rows)
    return format_grouped_table(
        _merge(rows),
        by="robot",
        titles=titles,
        row=format_row,
        head=[
            r"Method & Dynamics & $d$ & AE floor & MSE 0.5\,s & from next & $\varepsilon_{\mathrm{freq}}$ & "
            r"NRMSE & Image & Our gain & Ext. & Diverged & Steps & Recording \\",
            r" & & & $(10^{-5})$ & $(10^{-3})$ & $(10^{-3})$ & (\%) & latent & $/$ floor & $(10^{-3})$ & "
            r"force & rollouts & & \\",
        ],
        alignment="llcccccccccccl",
        caption=(
            "Half-second forecasts, free oscillation and two-period forecasts on the held-out part of the "
            f"{recordings}, {described} A rollout that diverges stays in every mean, scored no "
            "better than the mean prediction. The half second counts the given initial state as its first; "
            "from next, as many states follow it. Our gain is how much lower the half-second error of "
            "LaGSplat is on the same starts, with its 95 % interval over them. Steps are those of training "
            "an image model or a baseline. External force: where a force given in the image can act. Rows "
            "marked as the paper's are its own numbers, measured on its filmed recordings, and are not "
            "comparable with a simulated one."
        ),
        label="tab:krauss",
    )


def _name_recording(row: Mapping[str, Any]) -> str:
    """A recording as the caption calls it: a file that a user gave need not be what a camera saw."""
    return f"{row['recording']} recording" + (f" ({row['source']})" if row.get("source") else "")
