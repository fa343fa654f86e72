"""A name drawn from a hat, ``none`` among them."""

import numpy as np

from benchmarks.gap_baselines.case import Case
from benchmarks.gap_baselines.said import Said, names
from lagsplat.diagnose.core.config import DiagnoseConfig


def chance(case: Case, config: DiagnoseConfig) -> Said:
    """Every name equally probable, in an order that the recording's content decides."""
    every = [*names(), "none"]
    order = np.random.default_rng(case.seed).permutation(len(every))
    return Said({every[k]: 1.0 / len(every) for k in order})
