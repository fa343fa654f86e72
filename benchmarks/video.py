"""Time to read a film: decoding alone, then with crop and resize, then the whole reader with its checks.

Usage: ``python benchmarks/video.py [seconds]``. Makes a 1080p60 film of a pendulum before a textured wall
(MPEG-4, with sensor noise) in a temporary folder. Decoding alone is `cv2.VideoCapture.read` in the same
process, taken alternately with the others, so that a busy machine slows all alike.
"""

import statistics
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from lagsplat.io.video.clips import VideoClip
from lagsplat.io.video.decode import decode_frames, overlap_decoding
from lagsplat.io.video.read import read_video
from lagsplat.video_quality.frames import FrameSettings, crop_and_resize

WIDTH, HEIGHT, RATE = 1920, 1080, 60.0
SETTINGS = FrameSettings(crop=(420, 0, 1080, 1080), size=(128, 128))
ROUNDS = 5


def make_film(path: Path, seconds: float) -> None:
    rng = np.random.default_rng(0)
    wall = cv2.GaussianBlur(rng.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8), (0, 0), 6)
    wall = cv2.normalize(wall, None, 20, 230, cv2.NORM_MINMAX)
    noise = [rng.integers(0, 6, (HEIGHT, WIDTH, 3), dtype=np.uint8) for _ in range(8)]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"mp4v"), RATE, (WIDTH, HEIGHT))
    for i in range(round(seconds * RATE)):
        picture = cv2.add(wall, noise[rng.integers(len(noise))])
        angle = 0.6 * np.sin(2.0 * np.pi * i / RATE / 1.37)
        end = (round(960 + 700 * np.sin(angle)), round(100 + 700 * np.cos(angle)))
        cv2.line(picture, (960, 100), end, (20, 20, 20), 8, cv2.LINE_AA)
        cv2.circle(picture, end, 80, (30, 40, 220), -1, cv2.LINE_AA)
        writer.write(picture)
    writer.release()


def decode_alone(path: Path) -> None:
    capture = cv2.VideoCapture(str(path))
    while capture.read()[0]:
        pass
    capture.release()


def decode_and_shape(path: Path) -> None:
    def shape(item: Any) -> np.ndarray:
        return crop_and_resize(item[1], SETTINGS, source=str(path))

    for _ in overlap_decoding(decode_frames(VideoClip(path), SETTINGS), shape):
        pass


def read_whole(path: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        read_video(path, SETTINGS)


def seconds_of(action: Callable[[Path], None], path: Path) -> float:
    begin = time.perf_counter()
    action(path)
    return time.perf_counter() - begin


def main(seconds: float) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        make_film(path, seconds)
        print(f"{seconds:g} s of 1080p60, {path.stat().st_size / 1e6:.1f} MB, {SETTINGS}")
        actions = {
            "decode alone": decode_alone,
            "decode + crop + resize": decode_and_shape,
            "read_video, with its checks": read_whole,
        }
        taken: dict[str, list[float]] = {name: [] for name in actions}
        for _ in range(ROUNDS):
            for name, action in actions.items():
                taken[name].append(seconds_of(action, path))
        alone = statistics.median(taken["decode alone"])
        for name, times in taken.items():
            middle = statistics.median(times)
            print(
                f"{name:<28} {seconds / middle:5.1f} x real time (best {seconds / min(times):.1f}), "
                f"{middle / alone:.2f} times decoding alone"
            )


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 5.0)
