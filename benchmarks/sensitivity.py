"""Slopes of a sim's coefficients by the variational equations, as a multiple of the speed of differences.

Usage: ``python -m benchmarks.sensitivity [d1|d2|d4]...``. Makes the recordings of `benchmarks.diagnose`,
finds the sim of each, and differentiates its rollouts by every free coefficient and start both ways: best of
five.
"""

import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.diagnose import CASES
from benchmarks.gapgen.make import make_one
from lagsplat.config.compose import compose
from lagsplat.diagnose.data_quality.natural_period import estimate_spectral_period_s
from lagsplat.diagnose.estimation.dataset import cut_windows, prepare_dataset
from lagsplat.diagnose.estimation.multiple_shooting import ShootingData, differentiate_predictions
from lagsplat.diagnose.estimation.rollout import ParameterSensitivity
from lagsplat.diagnose.identification.structure_search import identify_model
from lagsplat.diagnose.mechanics.structure import list_free_directions
from lagsplat.io.sources import find_sources, read_sources

REPEATS = 5


def seconds(work: Callable[[], Any]) -> float:
    """The best of some runs, the first of which only compiles."""
    spent = []
    for _ in range(REPEATS + 1):
        began = time.perf_counter()
        work()
        spent.append(time.perf_counter() - began)
    return min(spent[1:])


def compare(case: str, folder: Path) -> str:
    """One line: unknowns, times, their ratio."""
    make_one((case, CASES[case], 1, "speed", str(folder), "T0"))
    config = compose().diagnose
    motions = read_sources(find_sources(f"{folder}/data/{case}/sim_*.csv"))
    period_s = estimate_spectral_period_s(motions)
    ready = prepare_dataset(motions, period_s=period_s)
    windows = cut_windows(ready.dataset, length_s=config.window_periods * period_s, min_frames=12)
    found = identify_model(ready, windows, config, period_s=period_s)
    moves = list_free_directions(found.model, found.structure, np.std(ready.dataset.v, axis=0))
    steps = max(1, int(np.ceil(ready.dataset.dt_s * config.steps_per_period / period_s)))
    moving = ParameterSensitivity(found.model, ready.dataset, found.windows, moves, steps, held=False)
    scale = np.concatenate([np.std(ready.dataset.q, axis=0), np.std(ready.dataset.v, axis=0)])
    weight = found.windows.mask()[..., None] / ready.sigma
    data = ShootingData(found.windows.take(ready.dataset.q), weight, 1e-4 * scale)
    x, starts = np.zeros(len(moves)), found.fit.starts
    exact = seconds(lambda: moving.derivatives(x, starts, data))
    by_differences = seconds(
        lambda: differentiate_predictions(moving, x, starts, data, np.full(len(x), 1e-5))
    )
    return (
        f"{case}: {len(moves)} coefficients and {len(starts)} starts of {starts.shape[1]}: exact "
        f"{1e3 * exact:.1f} ms, differences {1e3 * by_differences:.1f} ms, "
        f"{by_differences / exact:.1f} times as fast"
    )


def main(names: list[str]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        for case in names or list(CASES):
            print(compare(case, Path(folder)), flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
