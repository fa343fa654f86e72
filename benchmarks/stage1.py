"""Time of stage 1 on this machine, where a step spends it, and the full protocol that follows from it.

Usage: ``python benchmarks/stage1.py [threads]``. Trains briefly on a short simulated two-segment recording,
so that the Gaussians have the sizes of a real run, then times whole steps and their parts side by side.
"""

import os
import resource
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lagsplat.config.compose import compose
from lagsplat.provenance import set_threads
from lagsplat.splat.losses import structural_dissimilarity
from lagsplat.stage1.autoencoder import to_images
from lagsplat.stage1.fit import fit_autoencoder, train_step
from lagsplat.stage1.objective import make_optimizer, set_rates
from lagsplat.systems.simulate import simulate

WARM_STEPS = 400
FULL_STEPS = 68_600


def timed(action: Callable[[], object], *, repeat: int = 20) -> tuple[float, float]:
    """Median and least time of ``action`` [ms]."""
    action()
    times = []
    for _ in range(repeat):
        begin = time.perf_counter()
        action()
        times.append(1e3 * (time.perf_counter() - begin))
    return statistics.median(times), min(times)


def time_parts(threads: int) -> dict[str, tuple[float, float]]:
    """Median and least time of a step of the full protocol, and of its parts [ms]."""
    set_threads(threads)
    experiment = compose("system=krauss_2seg", "profile=full", f"stage1.steps={WARM_STEPS}")
    recording, _ = simulate(replace(experiment.simulation, n_frames=3000), seed=0)
    config = experiment.stage1
    begin = time.perf_counter()
    autoencoder, curve = fit_autoencoder(np.asarray(recording.frames), config, seed=0)
    print(f"{WARM_STEPS} steps from nothing: {time.perf_counter() - begin:.1f} s, mse {curve[-1].mse:.2e}")
    images = to_images(np.asarray(recording.frames)[:: len(recording.frames) // config.batch][: config.batch])
    optimizer = make_optimizer(autoencoder, config.rate)
    set_rates(optimizer, config.rate, step=WARM_STEPS, steps=FULL_STEPS)
    latents = autoencoder.encode(images).detach()
    parts = {
        "whole step": lambda: train_step(autoencoder, optimizer, images, config, 0),
        "encoder, forward and backward": lambda: autoencoder.encode(images).sum().backward(),
        "slice + rasteriser, forward and backward": lambda: autoencoder.decode(latents).sum().backward(),
        "SSIM, forward and backward": lambda: structural_dissimilarity(
            images.clone().requires_grad_(), images, window=config.loss.ssim_window
        ).backward(),
        "optimiser": optimizer.step,
    }
    print(f"{config.batch} frames of 32x32, {config.n_gaussians} Gaussians, d={config.d}, {threads} threads")
    return {name: timed(action) for name, action in parts.items()}


def main(threads: int) -> None:
    results = time_parts(threads)
    whole = results["whole step"][0]
    for name, (median, least) in results.items():
        print(f"  {name:42s} {median:7.2f} ms (least {least:.2f}), {median / whole:5.0%} of a step")
    print(f"full protocol of {FULL_STEPS} steps: {whole * FULL_STEPS / 6e4:.0f} min at this speed")
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.2f} GiB")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else os.cpu_count() or 1)
