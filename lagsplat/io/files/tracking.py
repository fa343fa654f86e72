"""Metrics of runs, kept where tools that compare runs read them: lines of JSON, or an MLflow store.

Results do not depend on it: what is kept is what a job has written anyway.
"""

import csv
import json
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from importlib.util import find_spec
from pathlib import Path
from typing import Any

TRACKING = ("none", "jsonl", "mlflow")
LINES = Path("results/tracking.jsonl")
"""File of the lines, in the folder where `snakemake` or `lagsplat` runs."""
EXPERIMENT = "lagsplat"  # in MLflow, where MLFLOW_EXPERIMENT_NAME names no other
MOST_PER_CALL = 1000  # metrics that a store of MLflow takes at once
MOST_CHARACTERS = 500  # of a setting in MLflow
Row = Mapping[str, Any]


def require_tracking(kind: str) -> None:
    """Check that metrics can be kept in this way, before anything is computed.

    Raises:
        ValueError: no such way, or its library is not installed.
    """
    if kind not in TRACKING:
        raise ValueError(f"tracking={kind} must be one of {', '.join(TRACKING)}; set it in conf/config.yaml")
    if kind == "mlflow" and find_spec("mlflow") is None:
        raise ValueError(
            "tracking=mlflow: MLflow is not installed here; pip install mlflow-skinny, or mlflow"
        )


def track(kind: str, rows: Sequence[Row], *, run: str, rule: str, settings: Mapping[str, Any]) -> None:
    """Keep the metrics of one stage of a run.

    Args:
        kind: ``none``, ``jsonl`` (one line a row, appended to `LINES`) or ``mlflow`` (a run of its own, in
            the store that MLflow's own variables such as ``MLFLOW_TRACKING_URI`` name).
        rows: Metrics by name; ``step`` is the number of the row, and text in it, such as the part of a fit,
            comes before the names. Numbers that are not finite are left out.
        run: Name of the run, for instance its folder.
        rule: The stage that measured.
        settings: Plain data that made it, nested mappings included.

    Raises:
        ValueError: see `require_tracking`.
        OSError: the file cannot be written.
    """
    require_tracking(kind)
    points = [(int(row.get("step", 0)), dict(_numbers(row))) for row in rows]
    if kind == "jsonl":
        _append_lines(points, {"run": run, "rule": rule}, settings)
    elif kind == "mlflow":
        _log_to_mlflow(points, run, rule, settings)


def read_curve(path: str | os.PathLike[str]) -> list[dict[str, Any]]:
    """Rows of a training curve as a job wrote it: numbers where a cell holds one."""
    with Path(path).open(encoding="utf-8", newline="") as file:
        return [{name: _number(text) for name, text in row.items()} for row in csv.DictReader(file)]


def read_scores(path: str | os.PathLike[str]) -> list[dict[str, Any]]:
    """The scores of an evaluation as one row; none where the file holds no scores."""
    found = json.loads(Path(path).read_text(encoding="utf-8"))
    return [found["scores"]] if "scores" in found else []


def _number(text: str) -> Any:
    try:
        return float(text)
    except ValueError:
        return text


def _numbers(row: Row) -> Iterator[tuple[str, float]]:
    part = "".join(f"{value}." for value in row.values() if isinstance(value, str))
    for name, value in row.items():
        if name != "step" and isinstance(value, int | float) and math.isfinite(value):
            yield f"{part}{name}", float(value)


def _append_lines(
    points: list[tuple[int, dict[str, float]]], names: Mapping[str, str], settings: Mapping[str, Any]
) -> None:
    about = {**names, "time_utc": datetime.now(UTC).isoformat(timespec="seconds")}
    records = [{**about, "step": step, "metrics": found} for step, found in points]
    # Once is enough: they are the same in all lines of a stage.
    records[:1] = [{**first, "settings": settings} for first in records[:1]]
    lines = [json.dumps(record) for record in records]
    content = "".join(f"{line}\n" for line in lines).encode()
    try:
        LINES.parent.mkdir(parents=True, exist_ok=True)
        # One write at the end of the file, so that jobs side by side do not mix their lines.
        with open(LINES, "ab", buffering=0) as file:
            written = file.write(content)
    except OSError as error:
        raise OSError(f"{LINES}: {error}; the lines of {names['rule']} are not kept there") from error
    if written != len(content):
        raise OSError(f"{LINES}: the disk is full; the lines of {names['rule']} are cut short there")


def _log_to_mlflow(
    points: list[tuple[int, dict[str, float]]], run: str, rule: str, settings: Mapping[str, Any]
) -> None:
    import mlflow  # type: ignore[import-not-found, unused-ignore]
    from mlflow.entities import Metric  # type: ignore[import-not-found, unused-ignore]

    if "MLFLOW_EXPERIMENT_NAME" not in os.environ:
        mlflow.set_experiment(EXPERIMENT)
    now = int(datetime.now(UTC).timestamp() * 1000)
    metrics = [Metric(name, value, now, step) for step, found in points for name, value in found.items()]
    with mlflow.start_run(run_name=f"{run} {rule}", tags={"run": run, "rule": rule}) as started:
        mlflow.log_params(dict(_flatten(settings)))
        for first in range(0, len(metrics), MOST_PER_CALL):
            some = metrics[first : first + MOST_PER_CALL]
            mlflow.MlflowClient().log_batch(started.info.run_id, metrics=some)


def _flatten(settings: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, str]]:
    for name, value in settings.items():
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{above}{name}.")
        else:
            yield f"{above}{name}", str(value)[:MOST_CHARACTERS]
