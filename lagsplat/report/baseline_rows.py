"""Rows of the published baselines beside ours, compared on the same starts."""

from collections.abc import Mapping, Sequence
from typing import Any

from lagsplat.evaluate.aggregate import aggregate, paired_margin
from lagsplat.report.rows import rows_of, table_row
from lagsplat.report.runs import grouped

METHODS = {
    "osc_deconv": "Osc. + deconv",
    "osc_abcd": "Osc. + ABCD",
    "koopman_deconv": "Koopman + deconv",
    "koopman_abcd": "Koopman + ABCD",
}
SCORE = "mse_half_second"
OWN = "default"  # conf/stage2/default.yaml: the dynamics that baselines are compared with


def with_baselines(
    runs: Sequence[Mapping[str, Any]],
    metrics: Sequence[dict[str, Any]],
    baseline_runs: Sequence[Mapping[str, Any]],
    baseline_metrics: Sequence[dict[str, Any]],
) -> list[dict[str, Any]]:
    """The rows of `rows_of`, and one for each baseline on each recording.

    A baseline's row has ``margin``: how much lower our half-second image error is on the same starts, with
    its 95 % interval over starts (``margin_low``, ``margin_high``) and seeds averaged on both sides. It is
    empty where we were not run on that recording.

    Raises:
        ValueError: a baseline and ours were scored on different starts of one recording.
    """
    places = grouped(runs, metrics).items()
    ours = {
        (place.system, place.recording, place.profile): variants.get(OWN, []) for place, variants in places
    }
    theirs: dict[tuple[str, str, str, str], list[dict[str, Any]]] = {}
    for run, scores in zip(baseline_runs, baseline_metrics, strict=True):
        key = (str(run["system"]), str(run["recording"]), str(run["profile"]), str(run["baseline"]))
        theirs.setdefault(key, []).append(scores)
    rows = rows_of(runs, metrics)
    for (system, recording, profile, name), members in theirs.items():
        row = table_row(
            aggregate(members),
            robot=system,
            method=METHODS.get(name, name),
            recording=recording,
            profile=profile,
        )
        rows.append(row | _margin(ours.get((system, recording, profile), []), members))
    return rows


def _margin(ours: list[dict[str, Any]], theirs: list[dict[str, Any]]) -> dict[str, Any]:
    if not ours:
        return {"margin": None, "margin_low": None, "margin_high": None}
    found = paired_margin(ours, theirs, score=SCORE)
    return {"margin": found["value"], "margin_low": found["low"], "margin_high": found["high"]}
