"""The table of speeds: the parts of the pipeline on this machine, beside their marks, and jobs that have run.

Usage: ``OMP_WAIT_POLICY=PASSIVE python -m benchmarks.speed OUT.csv [RESULTS]``, on an idle machine. Without
``RESULTS``, the folder of a workflow's runs, the parts are timed: the rasteriser beside the bound of its
arithmetic (see `benchmarks.raster`), one step of each stage at full size, drawing in space. With it the
minutes of processor time are written that each system's jobs took, as Snakemake recorded them.
"""

import os
import statistics
import sys
from pathlib import Path

import pandas as pd
import torch

from benchmarks import raster, space, stage1, stage2
from lagsplat.provenance import set_threads

THREADS = os.cpu_count() or 1
JOBS = {
    "recording": ("recording",),
    "stage 1": ("{run}/stage1",),
    "stage 2": ("{run}/chart", "{run}/{run}/stage2"),
    "scores": ("{run}/{run}/evaluate", "{run}/simple/evaluate"),
}
"""The jobs from nothing to the scores of one run, by stage."""


def time_rasteriser() -> list[dict[str, object]]:
    """Rows of the rasteriser: pairs a second, their share of the bound, and ratios to its rivals."""
    set_threads(THREADS)
    torch.set_num_threads(THREADS)
    pairs, times = raster.race(32, 64, 2048, gate=1.5, rounds=3)
    wall = {name: statistics.median(each.wall for each in own) for name, own in times.items()}
    ours, best = wall.pop("numba"), min(each.wall for each in times["numba"])
    bound = THREADS * raster.bound_of_core(raster.OPERATIONS_FORWARD + raster.OPERATIONS_BACKWARD)
    what = "rasteriser, 64 frames of 32x32, 2048 Gaussians, forward and backward"
    _, alone = raster.draw_alone(256, 15_000, gate=0.5, repeat=100)
    return [
        row(what, "million pairs/s", pairs / ours / 1e6, pairs / best / 1e6, mark="at least 300"),
        row("the same, share of the bound of AVX2", "%", 100 * pairs / ours / bound),
        *(row(f"the same, against {name}", "times as fast", other / ours) for name, other in wall.items()),
        row(
            "15 000 Gaussians in the picture, 256x256, one at a time",
            "pictures/s",
            1 / statistics.median(each.wall for each in alone),
            1 / min(each.wall for each in alone),
        ),
    ]


def time_stages() -> list[dict[str, object]]:
    """Rows of drawing in space and of one step of each stage."""
    step = stage1.time_parts(THREADS)["whole step"][0]
    law = 1e3 * stage2.time_parts()["step"]
    set_threads(THREADS)
    solid = space.time_pictures()["in space"]
    return [
        row("15 000 Gaussians in space, 256x256, four at a time", "pictures/s", solid, mark="at least 120"),
        row("stage 1, one step of 64 frames, 2048 Gaussians, d = 4", "ms", step),
        row(
            f"the same, {stage1.FULL_STEPS} steps (profile full)",
            "min",
            step * stage1.FULL_STEPS / 6e4,
            mark="at most 35",
        ),
        row("stage 2, one step of 32 windows, d = 4", "ms", law, mark="at most 4"),
    ]


def row(
    what: str, unit: str, value: float, best: float | None = None, *, mark: str = ""
) -> dict[str, object]:
    """A row of the table: the median, the best, and the project's mark."""
    return {"what": what, "unit": unit, "median": value, "best": best, "mark": mark, "cores": THREADS}


def read_minutes(folder: Path, run: str) -> dict[str, float]:
    """Minutes of the jobs of one run by stage, from Snakemake's records; empty where a record is missing."""
    paths = {
        stage: [folder / f"{name.format(run=run)}.tsv" for name in names] for stage, names in JOBS.items()
    }
    if not all(path.is_file() for each in paths.values() for path in each):
        return {}
    taken = {
        stage: sum(pd.read_csv(path, sep="\t")["cpu_time"].sum() for path in each) / 60
        for stage, each in paths.items()
    }
    return {**taken, "all": sum(taken.values())}


def gather_minutes(results: Path) -> list[dict[str, object]]:
    """Minutes of processor time by system and stage: medians over the seeds whose jobs have all run.

    Raises:
        FileNotFoundError: no system has run from its recording to its scores.
    """
    found = []
    for folder in sorted((results / "quick/benchmarks/simulated").iterdir()):
        runs = [read_minutes(folder, each.name) for each in sorted(folder.glob("default-*"))]
        if complete := [run for run in runs if run]:
            found.append({"system": folder.name, **pd.DataFrame(complete).median()})
    if not found:
        raise FileNotFoundError(
            f"{results} has no system with the records of all jobs; run the workflow there"
        )
    return found


if __name__ == "__main__":
    rows = gather_minutes(Path(sys.argv[2])) if len(sys.argv) > 2 else [*time_rasteriser(), *time_stages()]
    pd.DataFrame(rows).to_csv(sys.argv[1], index=False, float_format="%.4g")
