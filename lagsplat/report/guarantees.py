"""The table of what no learned law can break, asked of every one that was trained."""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

PATH = ("system", "recording", "profile", "stage1", "ae", "stage2", "seed")
FOUND = (
    "holds", "rise", "rise_at_half_step", "step_s", "starts", "far", "free_settled", "free_diverged",
    "free_time_s", "held_settled", "held_diverged", "held_time_s", "held_force_error", "reason",
)  # fmt: skip


def guarantee_table(runs: Sequence[Mapping[str, Any]], found: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """A row for each run with the results of `lagsplat.evaluate.guarantee.guarantee_of`.

    Raises:
        ValueError: no run.
    """
    if not runs:
        raise ValueError("no law to ask: train a run first")
    rows = [{name: run[name] for name in PATH} | dict(one) for run, one in zip(runs, found, strict=True)]
    return pd.DataFrame(rows, dtype=object).reindex(columns=[*PATH, *FOUND])
