"""Aggregate seeds into one row, compare two experiments window by window, and bootstrap over windows."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float64

SPREAD_OVER_SEEDS = "median and range over seeds"
SPREAD_OVER_WINDOWS = "one seed, 95 % interval over windows"
MEASURED = ("ae_floor", "mse_half_second", "mse_ahead", "frequency_error", "latent_nrmse", "image_ratio")
SERIES = {"mse_half_second": ("forecast", "per_window"), "image_mse": ("latent", "per_window_image")}


def aggregate(runs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Median and spread of the scores over runs that differ by their seed only.

    With several runs ``low`` and ``high`` are the extremes over all runs; with a single run they are its
    interval over windows. ``spread`` says which. A score that some runs lack is the median of the others,
    and ``n`` counts these. Diverged rollouts are summed, not averaged. ``training`` holds steps and frames of
    the first run and the mean wall time, None where unknown.

    Raises:
        ValueError: no run, or runs of different recordings, latent dimensions or kinds of dynamics.
    """
    if not runs:
        raise ValueError("nothing to aggregate: give the metrics of at least one run")
    for key in ("recording", "d", "dynamics"):
        values = {str(run[key]) for run in runs}
        if len(values) > 1:
            raise ValueError(f"runs of different {key} cannot share a row: {sorted(values)}")
    reach = sorted({run["scores"]["external_force"] for run in runs})
    spent = [run.get("training") or {} for run in runs]
    wall_s = [training["wall_s"] for training in spent if training.get("wall_s") is not None]
    return {
        **{key: runs[0][key] for key in ("schema", "recording", "d", "dynamics")},
        "n_seeds": len(runs),
        "spread": SPREAD_OVER_SEEDS if len(runs) > 1 else SPREAD_OVER_WINDOWS,
        "scores": {name: _spread(runs, name) for name in MEASURED},
        "external_force": " or ".join(reach),
        **{key: sum(run["scores"][key] for run in runs) for key in ("diverged", "rollouts")},
        "training": {
            "steps": spent[0].get("steps"),
            "frames_seen": spent[0].get("frames_seen"),
            "wall_s": float(np.mean(wall_s)) if wall_s else None,
        },
        "frequency_windows": runs[0]["frequency"]["n_windows"],
        "frequency_estimator": runs[0]["frequency"]["estimator"],
    }


def _spread(runs: Sequence[dict[str, Any]], name: str) -> dict[str, Any]:
    values = [run["scores"][name] for run in runs if run["scores"][name] is not None]
    if not values:
        return {"median": None, "low": None, "high": None, "n": 0}
    low, high = min(values), max(values)
    if len(runs) == 1:
        low, high = runs[0]["intervals"].get(name, (None, None))
    elif low == high:
        low = high = None
    return {"median": float(np.median(values)), "low": low, "high": high, "n": len(values)}


def paired_margin(
    first: Sequence[dict[str, Any]], second: Sequence[dict[str, Any]], *, score: str
) -> dict[str, Any]:
    """How much lower the error of ``first`` is than that of ``second`` on the same windows.

    Both are metrics of the runs of an experiment; ``score`` is ``mse_half_second`` or ``image_mse`` (two
    periods). Windows are paired by their start and averaged over seeds. ``value`` is ``mean(second) -
    mean(first)``, positive where ``first`` is better; ``relative`` divides it by ``mean(second)``;
    ``decided`` says that the bootstrap interval excludes zero.

    Raises:
        ValueError: the two experiments were not scored on the same windows of the same recording.
    """
    block, key = SERIES[score]
    runs = [*first, *second]
    if not first or not second or any(key not in run[block] for run in runs):
        raise ValueError(f"both sides need at least one run with {block}.{key}")
    if len({str((run["recording"], run[block]["starts"], run[block]["states"])) for run in runs}) > 1:
        raise ValueError("windows differ between the two sides; evaluate both with the same settings")
    ours, theirs = (np.mean([run[block][key] for run in side], axis=0) for side in (first, second))
    low, high = bootstrap_interval(lambda values: values.mean(axis=-1), theirs - ours)
    value = float((theirs - ours).mean())
    return {
        "score": score,
        "value": value,
        "low": low,
        "high": high,
        "relative": value / float(theirs.mean()),
        "decided": low > 0.0 or high < 0.0,
        "windows": len(ours),
    }


def bootstrap_interval(
    statistic: Callable[..., np.ndarray],
    *per_window: Float64[np.ndarray, " B"],
    resamples: int = 10_000,
    confidence: float = 0.95,
    seed: int = 0,
) -> list[float]:
    """Percentile interval of a statistic over windows drawn with replacement.

    ``statistic`` reduces the last axis of arrays (resamples, B), one for each of ``per_window``. Overlapping
    windows are treated as independent, which makes the interval slightly narrow.
    """
    count = per_window[0].shape[0]
    draws = np.random.default_rng(seed).integers(0, count, size=(resamples, count))
    values = statistic(*(values[draws] for values in per_window))
    tail = 50.0 * (1.0 - confidence)
    return [float(end) for end in np.percentile(values, [tail, 100.0 - tail])]
