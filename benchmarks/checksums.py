"""What the checksums of artefacts cost when a run is opened.

Usage: ``python benchmarks/checksums.py RUN``. Each artefact of the run is written anew into a temporary
folder, with checksums; then its loader and the checksums of its tensors alone are timed side by side. Frames
of a recording are mapped and read when they are needed, so they are also read once, as a training does.
"""

import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from lagsplat.chart.chart import load_chart
from lagsplat.io.files.artifact import checksum_of, load_artifact, save_artifact
from lagsplat.io.recording.recording import load_recording
from lagsplat.runs.run import locate_artefact
from lagsplat.stage1.autoencoder import load_autoencoder, to_images
from lagsplat.stage2.fit import load_dynamics

REPEAT = 15


def least(action: Callable[[], object]) -> float:
    """Least time of ``action`` [ms]; the files are in memory by then."""
    times = []
    for _ in range(REPEAT):
        begin = time.perf_counter()
        action()
        times.append(1e3 * (time.perf_counter() - begin))
    return min(times)


def checksums_of(tensors: dict[str, np.ndarray]) -> list[str]:
    return [checksum_of(tensor) for tensor in tensors.values()]


def main(run: Path) -> None:
    loaders: dict[str, Callable[[Path], object]] = {
        "recording": lambda path: to_images(np.asarray(load_recording(path).frames)),
        "autoencoder": load_autoencoder,
        "chart": load_chart,
        "dynamics": load_dynamics,
    }
    print(f"{'artefact':12} {'MB':>7} {'load [ms]':>10} {'checksums [ms]':>15} {'share [%]':>10}")
    with tempfile.TemporaryDirectory() as folder:
        for name, load in loaders.items():
            path = Path(folder) / f"{name}.safetensors"
            try:
                save_artifact(path, *load_artifact(locate_artefact(run, name)))
            except FileNotFoundError as error:
                print(f"{name:12} {error}")
                continue
            tensors, _ = load_artifact(path, mapped=("frames",) if name == "recording" else ())
            sums = least(partial(checksums_of, tensors))
            load_ms, size = least(partial(load, path)) - sums, path.stat().st_size / 1e6
            print(f"{name:12} {size:7.2f} {load_ms:10.3f} {sums:15.3f} {100 * sums / load_ms:10.1f}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
