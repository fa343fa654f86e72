"""Aggregate seeds into one row, compare two experiments window by window, and give intervals.

Tables of scores import this, so it uses neither torch nor `scipy.stats`, which take seconds to load.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64
from scipy.special import stdtrit

SPREAD_OVER_SEEDS = "median and range over seeds"
SPREAD_OVER_WINDOWS = "one seed, 95 % interval over windows"
MEASURED = ("ae_floor", "mse_half_second", "mse_ahead", "frequency_error", "latent_nrmse", "image_ratio")
MEAN_IMAGE = "Mean image"  # the simple predictor that a model must beat to have converged
SERIES = {"mse_half_second": ("forecast", "per_window"), "image_mse": ("latent", "per_window_image")}


def aggregate(runs: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Median and spread of the scores over runs that differ by their seed only.

    With several runs ``low`` and ``high`` are the extremes over all runs; with a single run they are its
    interval over windows. ``spread`` says which. A score that some runs lack is the median of the others,
    and ``n`` counts these. Diverged rollouts are summed, not averaged. ``windows`` counts the windows of half
    a second that do not overlap, ``long_windows`` those of two periods. ``training`` holds steps and frames
    of the first run and the mean wall time, None where unknown. Seeds of one fit may end with a linear law
    or with another: ``dynamics`` then names both.

    Raises:
        ValueError: no run, or runs of different recordings or latent dimensions.
    """
    if not runs:
        raise ValueError("nothing to aggregate: give the metrics of at least one run")
    for key in ("recording", "d"):
        values = {str(run[key]) for run in runs}
        if len(values) > 1:
            raise ValueError(f"runs of different {key} cannot share a row: {sorted(values)}")
    dynamics = sorted({run["dynamics"] for run in runs})
    reach = sorted({run["scores"]["external_force"] for run in runs})
    spent = [run.get("training") or {} for run in runs]
    wall_s = [training["wall_s"] for training in spent if training.get("wall_s") is not None]
    return {
        **{key: runs[0][key] for key in ("schema", "recording", "d")},
        "dynamics": " or ".join(dynamics),
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
        "windows": runs[0]["forecast"]["distinct"],
        "long_windows": runs[0]["latent"].get("distinct"),
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
    ``decided`` says that the interval over groups of distinct windows excludes zero; with fewer than three
    groups there is no interval, and nothing is decided.

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
    groups = group_windows(np.array(runs[0][block]["starts"]), runs[0][block]["states"])
    low, high = jackknife_interval(float, theirs - ours, groups=groups)
    value = float((theirs - ours).mean())
    return {
        "score": score,
        "value": value,
        "low": low,
        "high": high,
        "relative": value / float(theirs.mean()),
        "decided": low is not None and high is not None and (low > 0.0 or high < 0.0),
        "windows": len(ours),
    }


def group_windows(starts: Int64[np.ndarray, " B"], length: int) -> Int64[np.ndarray, " B"]:
    """Number of the group of each window of ``length`` frames; the first windows of groups do not overlap.

    There are as many distinct windows as groups. Errors of windows in one group are of the same motion.
    """
    groups, first, number = np.zeros(len(starts), dtype=np.int64), -length, -1
    for i in np.argsort(starts, kind="stable"):
        if starts[i] >= first + length:
            first, number = starts[i], number + 1
        groups[i] = number
    return groups


LEAST_GROUPS = 3  # of distinct windows: with two, the interval would be 25 standard errors wide


def jackknife_interval(
    statistic: Callable[..., float],
    *per_window: Float64[np.ndarray, " B"],
    groups: Int64[np.ndarray, " B"],
    confidence: float = 0.95,
    positive: bool = False,
) -> list[float | None]:
    """Interval of a statistic of means over windows, from the means without each group of windows.

    Args:
        statistic: Of the mean of each of ``per_window``.
        per_window: One value a window; windows overlap within a group, and hardly between groups.
        groups: Of each window, from `group_windows`.
        confidence: With which the interval holds, by Student's t with a degree fewer than groups.
        positive: Take the interval of the logarithm, which is nearer to normal for a size or a ratio.

    Returns:
        Lower and upper end, None for fewer than three groups.

    Source: Efron and Stein 1981, DOI 10.1214/aos/1176345462 (jackknife, deleting groups).
    """
    numbers = np.unique(groups)
    if len(numbers) < LEAST_GROUPS:
        return [None, None]
    middle = float(statistic(*(values.mean() for values in per_window)))
    without = np.array(
        [statistic(*(values[groups != number].mean() for values in per_window)) for number in numbers]
    )
    on_logarithm = positive and middle > 0.0 and bool((without > 0.0).all())
    if on_logarithm:
        without = np.log(without)
    degrees = len(numbers) - 1
    error = np.sqrt(degrees / len(numbers) * np.sum((without - without.mean()) ** 2))
    half = float(stdtrit(degrees, 0.5 + 0.5 * confidence) * error)
    if on_logarithm:
        with np.errstate(over="ignore"):
            return [middle * float(np.exp(-half)), middle * float(np.exp(half))]
    return [middle - half, middle + half]
