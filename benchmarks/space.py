"""Gaussians of space on this machine: pictures a second, and the time to fill a cache of views.

Usage: ``OMP_WAIT_POLICY=PASSIVE python benchmarks/space.py [threads] [PLY]``.

First the rasteriser: 15 000 Gaussians in 256 x 256 pixels, in space (projection and sort counted) and in the
picture, forward alone, taking turns so that other work on the machine hits both alike. Then the views of a
clip from PLY files: reading, merging and 65 cameras of 96 x 64 pixels, timed on a few frames and multiplied
to 133, which is an extrapolation. Without a ``PLY`` one of SHARP's size, 2 x 768 x 768 Gaussians, is made
up.
"""

import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from lagsplat.io.files.ply import PlyCloud, read_cloud, write_cloud
from lagsplat.provenance import set_threads
from lagsplat.splat.gaussians import GaussianSlice
from lagsplat.splat.image_model import rasterize
from lagsplat.splat.point_cloud import build_point_cloud, merge_clouds
from lagsplat.splat.projection import make_view, project
from lagsplat.views.camera import ViewSpace, arrange_cameras, center_camera
from lagsplat.views.config import ArrangementConfig

COUNT, SIZE, FOCAL = 15_000, 256, 900.0
BATCH, REPEATS = 4, 15
SIDE, FRAMES, CLIP = 768, 3, 133
ARRANGEMENT = ArrangementConfig(yaw_deg=15.0, pitch_deg=6.0, columns=13, rows=5, held_out=0)


def solid(batch: int) -> GaussianSlice:
    """Gaussians of some 1.5 px around the pivot, as a trained decoder has them."""
    generator = torch.Generator().manual_seed(0)
    spread = SIZE * (torch.rand(COUNT, 3, generator=generator) - 0.5)
    means = (spread + torch.tensor([0.0, 0.0, FOCAL])).expand(batch, -1, -1).contiguous()
    factor = torch.diag_embed(1.2 + 0.6 * torch.rand(COUNT, 3, generator=generator))
    factor[:, 1, 0] = 0.4 * torch.randn(COUNT, generator=generator)
    row, column = torch.tril_indices(3, 3)
    return GaussianSlice(
        means,
        (factor @ factor.mT)[:, row, column],
        torch.rand(batch, COUNT, generator=generator),
        torch.rand(COUNT, 3, generator=generator),
        torch.full((3,), 0.2),
    )


def seconds(rivals: dict[str, Callable[[], object]]) -> dict[str, float]:
    """Median seconds of each, in turns, after one call that compiles."""
    taken: dict[str, list[float]] = {name: [] for name in rivals}
    for turn in range(REPEATS + 1):
        for name, run in rivals.items():
            begin = time.perf_counter()
            run()
            if turn:
                taken[name].append(time.perf_counter() - begin)
    return {name: statistics.median(times) for name, times in taken.items()}


@torch.no_grad()
def time_pictures() -> dict[str, float]:
    """Pictures a second, in space and in the picture."""
    scene = solid(BATCH)
    view = make_view([center_camera(np.eye(3), np.zeros(3), focal=FOCAL, height=SIZE, width=SIZE)])
    size = {"height": SIZE, "width": SIZE}
    # The same Gaussians as seen from the front, nearest first and shared by all images, as in the picture.
    flat = project(scene._replace(means=scene.means[:1], opacity=scene.opacity[:1]), view, **size)
    plane = GaussianSlice(
        flat.means.expand(BATCH, -1, -1).contiguous(),
        flat.covariance[0],
        flat.opacity.expand(BATCH, -1).contiguous(),
        flat.color[0],
        flat.background,
    )
    found = seconds(
        {
            "in space": lambda: rasterize(*project(scene, view, **size), **size, backend="numba"),
            "in the picture": lambda: rasterize(*plane, **size, backend="numba"),
            "projection and sort alone": lambda: project(scene, view, **size),
        }
    )
    return {name: BATCH / taken for name, taken in found.items()}


def made_up() -> PlyCloud:
    """A grid of Gaussians of SHARP's size: a wavy surface, and a second one behind it."""
    rng = np.random.default_rng(0)
    row, column = np.divmod(np.arange(SIDE * SIDE), SIDE)
    parts = []
    for layer in range(2):
        depth = 2.0 + layer + 0.3 * np.sin(column / 90) * np.cos(row / 70)
        place = np.stack([(column / SIDE - 0.5) * depth, (row / SIDE - 0.5) * depth, depth], 1)
        parts.append((place, np.repeat(depth[:, None] / SIDE, 3, 1)))
    means, scales = (np.concatenate([part[i] for part in parts]) for i in range(2))
    turn = np.tile([1.0, 0.0, 0.0, 0.0], (len(means), 1))
    return PlyCloud(means, scales, turn, rng.random((len(means), 3)), np.full(len(means), 0.5))


@torch.no_grad()
def cache_speed(ply: Path | None) -> None:
    """Time of the views of one frame, and of a clip by extrapolation."""
    film = center_camera(np.eye(3), np.zeros(3), focal=96.0, height=64, width=96)
    cameras = arrange_cameras(ViewSpace(film, 2.0), ARRANGEMENT)[0]
    with tempfile.TemporaryDirectory() as folder:
        if ply is None:
            ply = Path(folder) / "frame.ply"
            write_cloud(ply, made_up())
        parts: dict[str, list[float]] = {"read": [], "merge": [], "views": []}
        for _ in range(FRAMES):
            marks = [time.perf_counter()]
            cloud = read_cloud(ply)
            marks.append(time.perf_counter())
            cloud = merge_clouds(cloud, side=SIDE, by=4, layers=2)
            marks.append(time.perf_counter())
            build_point_cloud(cloud, cameras, blur_px2=0.3)
            marks.append(time.perf_counter())
            for times, first, last in zip(parts.values(), marks, marks[1:], strict=False):
                times.append(last - first)
    medians = {name: statistics.median(times) for name, times in parts.items()}
    told = ", ".join(f"{name} {taken:.2f} s" for name, taken in medians.items())
    print(f"one frame, {len(cameras)} cameras of 96 x 64: {told}")
    whole = CLIP * sum(medians.values()) / 60
    print(
        f"{CLIP} frames x {len(cameras)} views from PLY: {whole:.1f} min, extrapolated from {FRAMES} frames"
    )


if __name__ == "__main__":
    given = [word for word in sys.argv[1:] if not word.isdigit()]
    threads = next((int(word) for word in sys.argv[1:] if word.isdigit()), 2)
    set_threads(threads)
    print(f"{threads} threads")
    for name, rate in time_pictures().items():
        print(f"{COUNT} Gaussians, {SIZE} x {SIZE}, {name}: {rate:.0f} pictures/s")
    cache_speed(Path(given[0]) if given else None)
