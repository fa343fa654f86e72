"""The rasterisers side by side on this machine, as ratios.

Usage: ``OMP_WAIT_POLICY=PASSIVE python benchmarks/raster.py [threads]``. Without that variable the idle
threads of torch and of Numba spin, and take the cores from each other.

A pair is a Gaussian and a pixel that it covers with alpha of at least 1/255. All rivals draw the same scene
in the same run, taking turns, so that other work on the machine hits them alike; the slow ones are given
fewer frames, and times are per frame. Processor time is that of all threads together.

The bound is that of arithmetic in AVX2, for the cores in use: each starts two operations on eight lanes in a
cycle. A pair costs 24 operations forward (2 for sigma, 9 for the exponential, 5 to blend transmittance and
three colours, 8 to clamp, compare and choose) and 37 backward (2, 9, 4 to unblend, 6 for colours, 9 for the
moments, 7 to clamp, compare and choose), a fused multiplication and addition or a division counted as one.
Loads and stores, what is done once per Gaussian, and pixels not covered count nothing: of eight pixels in a
run the Gaussians here cover five. Wider registers can pass the bound. The clock is measured, by
multiplications that wait for each other.

gsplat's pure-torch compositing (``gsplat.cuda._torch_impl.accumulate``) is timed without the search for
pairs, which exists only in CUDA, as do the two segmented products that it takes from nerfacc, which are
done in torch here. Both favour gsplat. It knows no end of a pixel at transmittance 1e-4.
"""

import os
import statistics
import sys
import time
import types
from collections.abc import Callable
from typing import NamedTuple

import numba
import torch
from torch import Tensor

from lagsplat.provenance import set_threads
from lagsplat.splat.image_model import evaluate_alphas, rasterize

Scene = list[Tensor]
LANES_PER_CYCLE = 2 * 8
OPERATIONS_FORWARD, OPERATIONS_BACKWARD = 24, 37
SLOW_FRAMES = 1


def gated_scene(batch: int, count: int, size: int, *, gate: float) -> Scene:
    """Gaussians of 1.4 to 1.9 px, their opacity gated in four latent dimensions as a decoder does it."""
    generator = torch.Generator().manual_seed(0)
    sigma = 1.65 * (0.85 + 0.3 * torch.rand(count, 2, generator=generator))
    correlation = torch.rand(count, generator=generator) - 0.5
    distance = torch.randn(batch, count, 4, generator=generator).square().sum(2)
    return [
        size * torch.rand(batch, count, 2, generator=generator),
        torch.stack([sigma[:, 0] ** 2, correlation * sigma.prod(1), sigma[:, 1] ** 2], 1),
        (0.2 + 0.75 * torch.rand(count, generator=generator)) * torch.exp(-0.5 * gate * distance),
        torch.rand(count, 3, generator=generator),
        torch.full((3,), 0.2),
    ]


def pairs_of(scene: Scene, size: int, frame: int) -> Tensor:
    """Covered (pixel, Gaussian) index pairs of a frame, pixel by pixel and front to back."""
    means, covariance, opacity = scene[:3]
    found = []
    for start in range(0, len(covariance), 256):
        part = slice(start, start + 256)
        alpha = evaluate_alphas(means[frame, part], covariance[part], opacity[frame, part], size, size)
        pairs = alpha.flatten(1).T.nonzero()
        found.append(pairs + torch.tensor([0, start]))
    pairs = torch.cat(found)
    return pairs[torch.argsort(pairs[:, 0] * len(covariance) + pairs[:, 1])]


def stand_in_for_nerfacc() -> types.ModuleType:
    """The two functions that gsplat takes from nerfacc, on any device."""

    def render_weight_from_alpha(alphas: Tensor, ray_indices: Tensor, n_rays: int) -> tuple[Tensor, Tensor]:
        passed = torch.log1p(-alphas)
        before = torch.cumsum(passed, 0) - passed
        first = torch.searchsorted(ray_indices, torch.arange(n_rays)).clamp(max=len(alphas) - 1)
        transmittance = torch.exp(before - before[first][ray_indices])
        return transmittance * alphas, transmittance

    def accumulate_along_rays(
        weights: Tensor, values: Tensor | None, ray_indices: Tensor, n_rays: int
    ) -> Tensor:
        light = weights[:, None] if values is None else weights[:, None] * values
        return torch.zeros(n_rays, light.shape[1]).index_add(0, ray_indices, light)

    module = types.ModuleType("nerfacc")
    module.render_weight_from_alpha = render_weight_from_alpha  # type: ignore[attr-defined]
    module.accumulate_along_rays = accumulate_along_rays  # type: ignore[attr-defined]
    return module


def gsplat_in_torch(size: int) -> Callable[[Scene], Tensor] | None:
    """gsplat's pure-torch compositing of the first frames of a scene; None where gsplat is not installed."""
    try:
        from gsplat.cuda import _torch_impl
    except ImportError:
        return None
    sys.modules["nerfacc"] = stand_in_for_nerfacc()
    known: dict[int, list[Tensor]] = {}

    def draw(scene: Scene) -> Tensor:
        means, covariance, opacity, color, background = scene
        frames = len(means)
        if frames not in known:
            found = [pairs_of([tensor.detach() for tensor in scene], size, frame) for frame in range(frames)]
            images = torch.cat([torch.full((len(pairs),), frame) for frame, pairs in enumerate(found)])
            known[frames] = [*torch.cat(found).unbind(1), images]
        pixels, gaussians, images = known[frames]
        blurred = covariance + torch.tensor([0.3, 0.0, 0.3])
        determinant = blurred[:, 0] * blurred[:, 2] - blurred[:, 1] ** 2
        conics = blurred[:, [2, 1, 0]] * torch.tensor([1.0, -1.0, 1.0]) / determinant[:, None]
        count = len(covariance)
        light, covered = _torch_impl.accumulate(
            means,
            conics.expand(frames, count, 3),
            opacity,
            color.expand(frames, count, 3),
            gaussians,
            pixels,
            images,
            size,
            size,
        )
        return (light + (1 - covered) * background).permute(0, 3, 1, 2)

    return draw


class Time(NamedTuple):
    """Seconds per frame on the clock, and of all processors together."""

    wall: float
    processor: float


def time_of(draw: Callable[[Scene], Tensor], scene: Scene, *, backward: bool) -> Time:
    """Time of one forward, or one forward and backward, per frame."""
    inputs = [tensor.clone().requires_grad_(backward) for tensor in scene]
    begin, begin_processor = time.perf_counter(), time.process_time()
    images = draw(inputs)
    if backward:
        images.backward(torch.ones_like(images))
    frames = len(scene[0])
    return Time(
        (time.perf_counter() - begin) / frames,
        (time.process_time() - begin_processor) / frames,
    )


@numba.njit
def multiply_in_turn(count: int) -> int:
    """Chain ``count`` multiplications of three cycles, each followed by an exclusive or of one."""
    value = 1
    for i in range(count):
        value = (value * value) ^ i
    return value


def clock_rate() -> float:
    """Cycles of a core per second of processor time, the best of a few."""
    count, times = 20_000_000, []
    multiply_in_turn(1)
    for _ in range(5):
        begin = time.process_time()
        multiply_in_turn(count)
        times.append(time.process_time() - begin)
    return 4 * count / min(times)


def bound_of_core(operations: int) -> float:
    """Pairs a second of one core in AVX2, where a pair costs so many operations."""
    return LANES_PER_CYCLE * clock_rate() / operations


def report_share(times: list[Time], pairs: float, operations: int) -> None:
    """Print pairs per second as a share of the bound: on the clock, and by processor time."""
    bound = bound_of_core(operations)
    cores = numba.get_num_threads()
    wall = pairs / statistics.median(t.wall for t in times) / (bound * cores)
    processor = pairs / statistics.median(t.processor for t in times) / bound
    print(
        f"    {wall:.0%} of the bound of AVX2, {bound * cores / 1e6:.0f} million pairs/s on {cores} cores;",
        end=" ",
    )
    print(f"{processor:.0%} by processor time", flush=True)


def report(name: str, times: list[Time], pairs: float, ours: list[Time] | None = None) -> None:
    """Time per frame with its spread, pairs per second, ratio to ours by medians and by the best."""
    wall = [t.wall for t in times]
    processor = statistics.median(t.processor for t in times)
    median, least = statistics.median(wall), min(wall)
    print(f"  {name}, {len(times)} times:")
    print(f"    {1e3 * median:.3f} ms a frame ({1e3 * least:.3f} to {1e3 * max(wall):.3f})", end=", ")
    print(f"{1e3 * processor:.3f} ms of processor time")
    print(f"    {pairs / median / 1e6:.2f} million pairs/s (best {pairs / least / 1e6:.2f})", flush=True)
    if ours is not None:
        by_median = median / statistics.median(t.wall for t in ours)
        by_processor = processor / statistics.median(t.processor for t in ours)
        print(
            f"    {by_median:.0f} times as long as numba (best against best {least / min(ours).wall:.0f},",
            end=" ",
        )
        print(f"processor time {by_processor:.0f})", flush=True)


def race(
    size: int, batch: int, count: int, *, gate: float, rounds: int
) -> tuple[float, dict[str, list[Time]]]:
    """Pairs a frame, and the times of each rasteriser forward and backward, taken in turns."""
    scene = gated_scene(batch, count, size, gate=gate)
    few = [tensor[:SLOW_FRAMES] if tensor.ndim > 1 and len(tensor) == batch else tensor for tensor in scene]
    pairs = sum(len(pairs_of(few, size, frame)) for frame in range(SLOW_FRAMES)) / SLOW_FRAMES

    def with_backend(name: str) -> Callable[[Scene], Tensor]:
        return lambda inputs: rasterize(*inputs, height=size, width=size, backend=name)

    rivals = {
        "numba": (with_backend("numba"), scene),
        "torch reference": (with_backend("torch"), few),
    }
    gsplat = gsplat_in_torch(size)
    if gsplat is None:
        print("  gsplat is not installed: its pure-torch compositing is left out")
    else:
        rivals["gsplat in pure torch"] = (gsplat, few)
        apart = (gsplat(few) - with_backend("torch")(few)).abs().max()
        print(f"  gsplat in pure torch and the torch reference differ by at most {apart:.1e}")
    times: dict[str, list[Time]] = {name: [] for name in rivals}
    for turn in range(rounds + 1):
        for name, (draw, frames) in rivals.items():
            for _ in range(10 if name == "numba" else 1):
                elapsed = time_of(draw, frames, backward=True)
                if turn:
                    times[name].append(elapsed)
    return pairs, times


def draw_alone(size: int, count: int, *, gate: float, repeat: int) -> tuple[float, list[Time]]:
    """Pairs of one frame, and the times to draw it forward."""
    scene = gated_scene(1, count, size, gate=gate)

    def draw(inputs: Scene) -> Tensor:
        return rasterize(*inputs, height=size, width=size, backend="numba")

    times = [time_of(draw, scene, backward=False) for _ in range(repeat + 3)][3:]
    return float(len(pairs_of(scene, size, 0))), times


def compare(size: int, batch: int, count: int, *, gate: float, rounds: int) -> None:
    """Print how the rasterisers compare, forward and backward."""
    print(f"{batch} frames x {count} Gaussians x {size}x{size}, forward + backward:")
    pairs, times = race(size, batch, count, gate=gate, rounds=rounds)
    print(f"  {pairs:.0f} pairs a frame")
    for name, own in times.items():
        report(name, own, pairs, None if name == "numba" else times["numba"])
        if name == "numba":
            report_share(own, pairs, OPERATIONS_FORWARD + OPERATIONS_BACKWARD)


def single_frame(size: int, count: int, *, gate: float, repeat: int) -> None:
    """Print the speed of one frame at a time."""
    pairs, times = draw_alone(size, count, gate=gate, repeat=repeat)
    print(f"1 frame x {count} Gaussians x {size}x{size}, {pairs:.0f} pairs, forward only:")
    report("numba", times, pairs)
    report_share(times, pairs, OPERATIONS_FORWARD)
    wall = [t.wall for t in times]
    print(f"    {1 / statistics.median(wall):.0f} frames/s (best {1 / min(wall):.0f})")


def main(threads: int) -> None:
    set_threads(threads)
    torch.set_num_threads(threads)  # its rivals are written in torch
    policy = os.environ.get("OMP_WAIT_POLICY", "not set")
    print(
        f"threads: numba {numba.get_num_threads()}, torch {torch.get_num_threads()}; OMP_WAIT_POLICY {policy}"
    )
    print(f"load of the machine over the last minute: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    compare(32, 64, 2048, gate=1.5, rounds=3)
    single_frame(256, 15_000, gate=0.5, repeat=100)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 2)
