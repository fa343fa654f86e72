"""How the time of drawing grows with frames, Gaussians, pixels and latent dimensions.

Usage: ``OMP_WAIT_POLICY=PASSIVE python -m benchmarks.growth OUT.csv``, then ``... OUT.png`` draws that table.
One forward and backward pass of an untrained image model, conditioning and rasteriser, on all cores; one
quantity varies at a time from `BASE`. Gaussians become as much wider as the picture does. Every case has its
turn in each of `ROUNDS` rounds, so that other work on the machine meets all alike.
"""

import csv
import math
import statistics
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

import pandas as pd
import torch
from numba import get_num_threads

from lagsplat.report.common import style
from lagsplat.splat.gaussians import Gaussians
from lagsplat.splat.image_model import rasterize

ROUNDS = 7
WIDTH = 1.65 / 32  # of a Gaussian, as a share of the picture


@dataclass(frozen=True)
class Case:
    """What is drawn: ``frames`` pictures of ``side`` x ``side`` pixels."""

    frames: int = 32
    gaussians: int = 2048
    side: int = 32
    d: int = 2


BASE = Case()
SWEEPS = {
    "frames": (4, 8, 16, 32, 64, 128),
    "gaussians": (256, 512, 1024, 2048, 4096, 8192, 16384),
    "side": (16, 32, 64, 128, 256),
    "d": (1, 2, 4, 8, 16),
}
TITLES = {
    "frames": "frames a step",
    "gaussians": "Gaussians",
    "side": "pixels along a side",
    "d": "latent dimensions",
}


def make_cloud(case: Case) -> Gaussians:
    """Gaussians all over the picture, gated in the latent space as a decoder does it."""
    torch.manual_seed(0)
    cloud = Gaussians(case.gaussians, case.d)
    with torch.no_grad():
        cloud.center.uniform_(0.0, case.side)
        cloud.latent_center.normal_(0.0, case.d**-0.5)  # as many gates are open for any d
        cloud.coupling.normal_(0.0, 0.1 * case.side)
        cloud.shape_log_diagonal.normal_(math.log(WIDTH * case.side), 0.1)
        cloud.opacity_logit.normal_(1.0)
    return cloud


def time_step(cloud: Gaussians, case: Case) -> float:
    """Time of one forward and backward pass [ms]."""
    z = case.d**-0.5 * torch.randn(case.frames, case.d, generator=torch.Generator().manual_seed(1))
    began = time.perf_counter()
    scene = cloud.condition(z)
    rasterize(*scene, height=case.side, width=case.side, backend="numba").sum().backward()
    return 1e3 * (time.perf_counter() - began)


def measure(path: Path) -> None:
    """Write the quartiles of the times of every case."""
    cases = [(name, replace(BASE, **{name: value})) for name, values in SWEEPS.items() for value in values]
    clouds = [make_cloud(case) for _, case in cases]
    times: list[list[float]] = [[] for _ in cases]
    for turn in range(ROUNDS + 1):
        for own, cloud, (_, case) in zip(times, clouds, cases, strict=True):
            taken = time_step(cloud, case)
            own.extend([taken] if turn else [])  # the first one compiles
    with path.open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(["quantity", "value", "ms", "quarter_ms", "three_quarters_ms", "threads"])
        for own, (name, case) in zip(times, cases, strict=True):
            quarter, median, three = statistics.quantiles(own)
            numbers = [f"{value:.4g}" for value in (median, quarter, three)]
            table.writerow([name, getattr(case, name), *numbers, get_num_threads()])


def draw(path: Path) -> None:
    """Draw the table beside the picture, both axes in decades, with a line of slope one."""
    table = pd.read_csv(path.with_suffix(".csv"))
    with style.paper_style():
        figure = style.new_figure(style.PAGE_IN, 2.1)
        axes = figure.subplots(1, len(SWEEPS), sharey=True)
        for axis, name in zip(axes, SWEEPS, strict=True):
            rows = table[table["quantity"] == name]
            x, y = rows["value"].to_numpy(float), rows["ms"].to_numpy()
            between = rows["quarter_ms"], rows["three_quarters_ms"]
            axis.fill_between(x, *between, color=style.ENCODED, alpha=0.2, linewidth=0)
            axis.plot(x, y, "o-", color=style.ENCODED, markersize=3)
            power = 2 if name == "side" else 1
            axis.plot(x, y[-1] * (x / x[-1]) ** power, "--", color=style.QUIET, linewidth=0.8)
            words = "proportional to pixels" if power == 2 else "proportional"
            axis.text(0.96, 0.06, words, transform=axis.transAxes, ha="right", color=style.QUIET)
            axis.set(xscale="log", yscale="log", xlabel=TITLES[name])
            axis.set_xticks(x[::2], [f"{value:g}" for value in x[::2]])
            axis.minorticks_off()
        axes[0].set_ylabel("one step (ms)")
        style.save_figure(path, figure)


if __name__ == "__main__":
    out = Path(sys.argv[1])
    (measure if out.suffix == ".csv" else draw)(out)
