"""Error of a chart's latents with and without refinement, against the true coordinates.

Run as ``python benchmarks/latents.py RUN...`` after ``snakemake``, with folders of simulated recordings such
as ``results/quick/simulated/pendulum/default-0``. An encoder is free to bend the coordinates smoothly. What
counts as an error is the part of a latent that no polynomial of degree `DEGREE` of the true coordinates
explains: fitted to every second frame, measured on the others, relative to the latent's own deviation.
"""

import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from lagsplat.array_types import Series
from lagsplat.chart.chart import load_chart
from lagsplat.integer_lists import list_powers
from lagsplat.io.recording.recording import load_recording
from lagsplat.stage1.autoencoder import load_autoencoder
from lagsplat.systems.truth import load_truth

DEGREE = 4
MOST = 3000  # frames, evenly spaced


def list_features(states: Series) -> Series:
    """Monomials of standardised states up to `DEGREE`."""
    x = (states - states.mean(0)) / states.std(0)
    d = x.shape[1]
    powers = list_powers(d, lowest=0, highest=DEGREE)
    return np.stack([np.prod(x[:, np.repeat(np.arange(d), power)], axis=1) for power in powers], axis=1)


def measure_error(latents: Series, states: Series) -> Float64[np.ndarray, " d"]:
    """Share of each latent's deviation that the true coordinates do not explain."""
    features = list_features(states)
    weights = np.linalg.lstsq(features[::2], latents[::2], rcond=None)[0]
    missed = (latents - features @ weights)[1::2]
    return np.sqrt(np.mean(missed**2, axis=0)) / latents.std(0)


def main(places: list[str]) -> None:
    """Print a row for each run: errors by the encoder alone, after one step and after two, and their cost."""
    print("| recording | encoder | 1 step | 2 steps | ms a frame and step |")
    print("|---|---|---|---|---|")
    for place in map(Path, places):
        chart, _ = load_chart(place / "chart.safetensors")
        autoencoder, _ = load_autoencoder(place / "autoencoder.safetensors")
        recording = load_recording(place.parent / "recording.safetensors")
        truth, _ = load_truth(place.parent / "truth.safetensors")
        at = np.unique(np.linspace(0, recording.n_frames - 1, MOST).astype(int))
        frames, cells, seconds = np.asarray(recording.frames[at]), [], []
        for steps in (0, 1, 2):
            began = time.perf_counter()
            latents = replace(chart, refinement_steps=steps).encode(autoencoder, frames)
            seconds.append(time.perf_counter() - began)
            cells.append(", ".join(f"{error:.3f}" for error in measure_error(latents, truth.states[at])))
        cost = 1e3 * (seconds[2] - seconds[1]) / len(at)
        print(f"| {place.parent.name} | {' | '.join(cells)} | {cost:.2f} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
