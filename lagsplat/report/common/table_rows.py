"""Rows of the tables: runs grouped by what they share, one row a group, and the paper's own beside them."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from lagsplat.evaluate.aggregate import MEASURED, aggregate, paired_margin
from lagsplat.report.common.formatting import capitalize_first, join_distinct
from lagsplat.report.common.printed_table import Column, Row, make_text_column
from lagsplat.report.common.published_values import RECORDING, list_paper_rows


class RunGroup(NamedTuple):
    """Runs over one autoencoder, whose dynamics can be compared."""

    system: str
    recording: str
    profile: str
    stage1: str

    @property
    def place(self) -> dict[str, str]:
        """The columns that say what was measured and how."""
        return {"recording": self.recording, "profile": self.profile}


def group_runs(
    runs: Sequence[Mapping[str, Any]], metrics: Sequence[dict[str, Any]]
) -> dict[RunGroup, dict[str, list[dict[str, Any]]]]:
    """Group the scores of all seeds by autoencoder and then by dynamics, in the order of their first run.

    ``runs`` are the wildcards of each run's path (profile, recording, system, stage1, ae, stage2, seed), with
    the scores of each in ``metrics``.
    """
    groups: dict[RunGroup, dict[str, list[dict[str, Any]]]] = {}
    for run, scores in zip(runs, metrics, strict=True):
        group = RunGroup(*(str(run[name]) for name in RunGroup._fields))
        groups.setdefault(group, {}).setdefault(str(run["stage2"]), []).append(scores)
    return groups


def build_rows(runs: Sequence[Mapping[str, Any]], metrics: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Build one row for each group of runs that differ by their seeds only, in the order of their first run.

    ``runs`` and ``metrics`` as in `group_runs`. Dynamics other than the default are named with the method.
    """
    rows = []
    for group, variants in group_runs(runs, metrics).items():
        for stage2, members in variants.items():
            method = "LaGSplat" + name_changes(group.stage1, stage2)
            rows.append(build_row(aggregate(members), robot=group.system, method=method, **group.place))
    return rows


def build_simple_rows(
    runs: Sequence[Mapping[str, Any]], simple: Sequence[dict[str, Any]]
) -> list[dict[str, Any]]:
    """Build one row for each simple predictor on each recording, over the autoencoders that drew it.

    ``runs`` are the wildcards of the autoencoders, ``simple`` for each of them what
    `lagsplat.evaluate.simple_predictors.evaluate_simple_predictors` gave.
    """
    return [
        build_row(aggregate(members), robot=group.system, method=method, **group.place)
        for (group, method), members in group_simple(runs, simple).items()
    ]


def group_simple(
    runs: Sequence[Mapping[str, Any]], simple: Sequence[dict[str, Any]]
) -> dict[tuple[RunGroup, str], list[dict[str, Any]]]:
    """Group the scores of simple predictors by recording and method; arguments as of `build_simple_rows`."""
    groups: dict[tuple[RunGroup, str], list[dict[str, Any]]] = {}
    for run, predictors in zip(runs, simple, strict=True):
        group = RunGroup(*(str(run[name]) for name in RunGroup._fields))
        for name, scores in predictors.items():
            method = name + name_changes(group.stage1, "default")
            groups.setdefault((group, method), []).append(scores)
    return groups


def name_changes(stage1: str, stage2: str) -> str:
    """Name the settings that are not the default, such as `` (constant)``; empty where all are."""
    changed = ", ".join(name for name in (stage1, stage2) if name != "default")
    return f" ({changed})" if changed else ""


def build_row(
    aggregated: Mapping[str, Any], *, robot: str, method: str, recording: str, profile: str
) -> dict[str, Any]:
    """Build one row from the scores of `lagsplat.evaluate.aggregate.aggregate`.

    Ratios and errors are plain numbers (a frequency error of 0.05 is five per cent); a score without spread
    has no ``_low`` and ``_high``.

    Raises:
        ValueError: the recording's own origin is another one than ``recording`` says.
    """
    origin = aggregated["recording"]["origin"]
    if origin is not None and not recording.startswith(origin):
        raise ValueError(
            f"{robot}: the scores are of a {origin} recording and the row would say {recording!r}; "
            "gather the metrics of that recording's own folder"
        )
    scores = aggregated["scores"]
    row: dict[str, Any] = {
        "robot": robot,
        "method": method,
        "dynamics": aggregated["dynamics"],
        "d": aggregated["d"],
        **{name: scores[name]["median"] for name in MEASURED},
        "external_force": aggregated["external_force"],
        "diverged": aggregated["diverged"],
        "recording": recording,
        "profile": profile,
        "n_seeds": aggregated["n_seeds"],
        **{name: aggregated[name] for name in ("rollouts", "windows", "long_windows")},
        "spread": aggregated["spread"],
        "source": aggregated["recording"].get("source"),
        **aggregated["training"],
    }
    for name in MEASURED:
        row[f"{name}_low"], row[f"{name}_high"] = scores[name]["low"], scores[name]["high"]
    return row


def merge_with_published(
    rows: Sequence[Mapping[str, Any]], paper: Callable[[set[str]], list[dict[str, Any]]] = list_paper_rows
) -> pd.DataFrame:
    """Merge the rows with the paper's own, robot by robot in the order of the rows.

    ``paper`` gives the paper's rows of the named robots.

    Raises:
        ValueError: no row.
    """
    if not rows:
        raise ValueError("a table needs at least one row; evaluate a run first")
    robots = list(dict.fromkeys(row["robot"] for row in rows))
    merged = pd.DataFrame([*rows, *paper(set(robots))], dtype=object)
    merged = merged.sort_values("robot", key=lambda names: names.map(robots.index), kind="stable")
    return merged.reset_index(drop=True)


def build_table(rows: Sequence[Mapping[str, Any]], columns: Sequence[str]) -> pd.DataFrame:
    """Build a table with these columns; a cell is empty where its row has no such key."""
    return pd.DataFrame(list(rows), dtype=object).reindex(columns=list(columns))


def take_median(values: Iterable[float | None]) -> float | None:
    """Take the median of what was measured; None where nothing was."""
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else None


def list_spread_columns(frame: pd.DataFrame, scores: Sequence[str]) -> list[str]:
    """List the ``_low`` and ``_high`` columns of those scores that have a spread in any row."""
    bounds = [f"{name}_{end}" for name in scores for end in ("low", "high")]
    return [name for name in bounds if name in frame and frame[name].notna().any()]


def name_block(row: Row, titles: Mapping[str, str], *, key: str = "system") -> str:
    """Name the system of a row and its recording, with the file that a user gave."""
    title, source = titles.get(str(row[key]), str(row[key])), row.get("source")
    file = f" {source}" if isinstance(source, str) and not str(row["recording"]).startswith("sim") else ""
    return f"{capitalize_first(title)} ({row['recording']}{file})"


def make_diverged_column() -> Column:
    """Make the column of how many rollouts diverged, of how many where that is known."""

    def write(row: Row) -> str | None:
        diverged, rollouts = (row.get(name) for name in ("diverged", "rollouts"))
        if diverged is None or pd.isna(diverged):
            return None
        return f"{int(diverged)}" + ("" if rollouts is None or pd.isna(rollouts) else f"/{int(rollouts)}")

    note = "Diverged: rollouts, which stay in every mean, scored no better than the mean prediction."
    return make_text_column("Diverged", write, note=note)


def describe_runs(frame: pd.DataFrame) -> str:
    """Describe profiles, values and brackets of our own rows for a caption."""
    ours = frame[frame["recording"] != RECORDING]
    seeds = sorted({int(number) for number in ours["n_seeds"].dropna()})
    windows = "95 % intervals over windows"
    several = f"medians and ranges over {' or '.join(str(n) for n in seeds if n > 1)} seeds"
    told = [several if seeds[-1] > 1 else f"one seed, {windows}"]
    told += [f"of one seed {windows}"] if seeds[0] == 1 and len(seeds) > 1 else []
    return f"Profile {join_distinct(ours['profile'])}; {'; '.join(told)}."


def tell_of_paper(frame: pd.DataFrame, text: str) -> str:
    """Give ``text`` where a row is the paper's own; else an empty text."""
    return text if (frame["recording"] == RECORDING).any() else ""


def measure_margin(
    runs: Sequence[dict[str, Any]], reference: Sequence[dict[str, Any]], score: str
) -> dict[str, float | None]:
    """Measure how much lower ``runs`` score than ``reference`` on the same starts, with the 95 % interval.

    The values are None without runs.

    Raises:
        ValueError: the two were scored on different starts.
    """
    if not runs:
        return {"margin": None, "margin_low": None, "margin_high": None}
    margin = paired_margin(runs, reference, score=score)
    return {"margin": margin["value"], "margin_low": margin["low"], "margin_high": margin["high"]}
