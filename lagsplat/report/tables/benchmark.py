"""Rows of the published baselines beside ours, compared on the same starts.

What a variant of the dynamics gains over the constant-coefficient one, window by window.

The benchmark table of the pneumatic arms, for reading by machine and by LaTeX.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from lagsplat.baselines.config import BASELINE_TITLES
from lagsplat.evaluate.aggregate import MEASURED, SERIES, aggregate, paired_margin
from lagsplat.report.common.formatting import (
    escape_latex,
    format_block_title,
    format_cells,
    format_latex_table,
)
from lagsplat.report.common.published_values import list_paper_baselines, list_paper_rows
from lagsplat.report.common.table_rows import (
    build_row,
    build_rows,
    count_rollouts,
    describe_runs,
    format_diverged,
    format_score,
    group_runs,
    list_spread_columns,
    merge_with_published,
)

MARGIN_SCORE = "mse_half_second"
DEFAULT_DYNAMICS = "default"  # conf/stage2/default.yaml: the dynamics that baselines are compared with


def build_benchmark_rows(
    runs: Sequence[Mapping[str, Any]],
    metrics: Sequence[dict[str, Any]],
    baseline_runs: Sequence[Mapping[str, Any]],
    baseline_metrics: Sequence[dict[str, Any]],
) -> list[dict[str, Any]]:
    """The rows of `build_rows`, and one for each baseline on each recording.

    A baseline's row has ``margin``: how much lower our half-second image error is on the same starts, with
    its 95 % interval over starts (``margin_low``, ``margin_high``) and seeds averaged on both sides. It is
    empty where we were not run on that recording.

    Raises:
        ValueError: a baseline and ours were scored on different starts of one recording.
    """
    places = group_runs(runs, metrics).items()
    ours = {
        (place.system, place.recording, place.profile): variants.get(DEFAULT_DYNAMICS, [])
        for place, variants in places
    }
    theirs: dict[tuple[str, str, str, str], list[dict[str, Any]]] = {}
    for run, scores in zip(baseline_runs, baseline_metrics, strict=True):
        key = (str(run["system"]), str(run["recording"]), str(run["profile"]), str(run["baseline"]))
        theirs.setdefault(key, []).append(scores)
    rows = build_rows(runs, metrics)
    for (system, recording, profile, name), members in theirs.items():
        row = build_row(
            aggregate(members),
            robot=system,
            method=BASELINE_TITLES.get(name, name),
            recording=recording,
            profile=profile,
        )
        rows.append(row | _margin(ours.get((system, recording, profile), []), members))
    return rows


def _margin(ours: list[dict[str, Any]], theirs: list[dict[str, Any]]) -> dict[str, Any]:
    if not ours:
        return {"margin": None, "margin_low": None, "margin_high": None}
    found = paired_margin(ours, theirs, score=MARGIN_SCORE)
    return {"margin": found["value"], "margin_low": found["low"], "margin_high": found["high"]}


CONSTANT_DYNAMICS = "constant"  # conf/stage2/constant.yaml
MARGIN_COLUMNS = (
    "robot", "dynamics", "baseline", "score", "value", "low", "high", "relative", "decided", "windows",
    "recording", "profile", "n_seeds",
)  # fmt: skip


def build_margin_table(runs: Sequence[Mapping[str, Any]], metrics: Sequence[dict[str, Any]]) -> pd.DataFrame:
    """A row for each score and each variant that has a constant-coefficient run beside it.

    ``runs`` and ``metrics`` as in `group_runs`. ``value`` is how much lower the variant errs, with its bootstrap
    interval over windows, seeds averaged on both sides; ``decided`` says that the interval excludes zero.
    Without a constant-coefficient run the table is empty.
    """
    rows: list[dict[str, Any]] = []
    for (system, recording, profile, _), variants in group_runs(runs, metrics).items():
        baseline = variants.pop(CONSTANT_DYNAMICS, [])
        for name, members in variants.items() if baseline else ():
            for score, (block, key) in SERIES.items():
                if not all(key in run[block] for run in [*members, *baseline]):
                    continue  # no natural period, hence nothing was scored over two of them
                margin = paired_margin(members, baseline, score=score)
                rows.append(
                    {"robot": system, "dynamics": name, "baseline": CONSTANT_DYNAMICS, **margin}
                    | {"recording": recording, "profile": profile, "n_seeds": len(members)}
                )
    return pd.DataFrame(rows, columns=list(MARGIN_COLUMNS))


BENCHMARK_COLUMNS = (
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
BENCHMARK_SCALES = {"ae_floor": 1e5, "mse_half_second": 1e3, "mse_ahead": 1e3, "frequency_error": 1e2}


def build_benchmark_table(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Our rows and the paper's own beside them, robot by robot.

    The columns are `BENCHMARK_COLUMNS`, then ``_low`` and ``_high`` of each metric that has a spread anywhere.

    Raises:
        ValueError: no row.
    """
    everything = merge_with_published(rows, _of_paper)
    return everything.reindex(columns=[*BENCHMARK_COLUMNS, *list_spread_columns(everything, MEASURED)])


def _of_paper(robots: set[str]) -> list[dict[str, Any]]:
    return [*list_paper_rows(robots), *list_paper_baselines(robots)]


def format_benchmark_latex(rows: Sequence[Mapping[str, Any]], *, titles: Mapping[str, str]) -> str:
    """The same table in LaTeX, for ``\\input`` in any article (booktabs is used where it is loaded).

    ``titles`` gives the heading of each robot's block. The caption names the recordings, the profiles and
    what the brackets are.
    """
    frame = build_benchmark_table(rows)
    rollouts = count_rollouts(rows)
    body: list[str] = []
    for robot, block in frame.groupby("robot", sort=False):
        body += [format_block_title(titles.get(str(robot), str(robot)), columns=14)]
        body += [_line(row, rollouts) for row in block.to_dict("records")]
    head = [
        r"Method & Dynamics & $d$ & AE floor & MSE 0.5\,s & from next & $\varepsilon_{\mathrm{freq}}$ & "
        r"NRMSE & Image & Our gain & Ext. & Diverged & Steps & Recording \\",
        r" & & & $(10^{-5})$ & $(10^{-3})$ & $(10^{-3})$ & (\%) & latent & $/$ floor & $(10^{-3})$ & force & "
        r"rollouts & & \\",
    ]
    return format_latex_table(
        head=head, body=body, columns="@{}llcccccccccccl@{}", caption=_caption(rows), label="tab:krauss"
    )


def _caption(rows: Sequence[Mapping[str, Any]]) -> str:
    recordings = " and ".join(sorted({_named(row) for row in rows}))
    return (
        f"Half-second forecasts, free oscillation and two-period forecasts on the held-out part of the "
        f"{recordings}, {describe_runs(rows)} A rollout that diverges stays in every mean, scored no better "
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
    return format_cells(
        escape_latex(str(row["method"])),
        escape_latex(str(row["dynamics"])),
        str(row["d"]),
        *(format_score(row, name, scale=BENCHMARK_SCALES.get(name, 1.0)) for name in MEASURED),
        format_score(row, "margin", scale=BENCHMARK_SCALES["mse_half_second"]),
        escape_latex(str(row["external_force"])),
        format_diverged(row, rollouts),
        _count(row.get("steps")),
        escape_latex(str(row["recording"])),
    )
