"""What a LeRobot episode of 60 s with two cameras costs: to inspect it, to read its numbers, and one camera.

Usage: ``python -m benchmarks.lerobot [seconds]``. Makes a dataset of version 3.0 in a temporary folder: six
joints at 30 frames/s, and two films of 640 x 480 pixels in AV1 as LeRobot encodes it, a textured wall before
which a square moves. Each call is timed in this process, after its imports.
"""

import json
import shutil
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from lagsplat.io.config import LerobotConfig
from lagsplat.io.lerobot.recording import read_lerobot
from lagsplat.io.lerobot.survey import survey_lerobot
from lagsplat.io.lerobot.trajectory import read_lerobot_trajectory
from lagsplat.report.inspection.dataset import describe_lerobot
from lagsplat.video_quality.frames import FrameSettings

WIDTH, HEIGHT, RATE = 640, 480, 30
CAMERAS = ("observation.images.front", "observation.images.wrist")
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
ENCODING = {"g": "2", "crf": "30", "preset": "12"}  # LeRobot's, at the encoder's fastest
FRAME = (72, 96)  # as `lagsplat inspect` proposes


def make_film(path: Path, frames: int) -> None:
    rng = np.random.default_rng(0)
    wall = cv2.GaussianBlur(rng.integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8), (0, 0), 6)
    path.parent.mkdir(parents=True)
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libsvtav1", RATE, options=ENCODING)
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.time_base = Fraction(1, RATE)
        for step in range(frames):
            left = round(260 + 240 * np.sin(2.0 * np.pi * step / RATE / 1.7))
            picture = cv2.rectangle(wall.copy(), (left, 200), (left + 80, 280), (20, 20, 220), -1)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="bgr24")))
        container.mux(stream.encode())


def make_dataset(folder: Path, frames: int) -> None:
    first, *others = (folder / f"videos/{camera}/chunk-000/file-000.mp4" for camera in CAMERAS)
    make_film(first, frames)
    for other in others:
        other.parent.mkdir(parents=True)
        shutil.copy(first, other)
    time_s = np.arange(frames) / RATE
    angles = 120.0 * np.sin(time_s[:, None] + np.arange(len(JOINTS))).astype(np.float32)
    block = pa.FixedSizeListArray.from_arrays(pa.array(angles.ravel()), len(JOINTS))
    numbers = {"action": block, "observation.state": block, "timestamp": time_s.astype(np.float32)}
    whole = {name: np.arange(frames) for name in ("frame_index", "index")}
    zeros = {name: np.zeros(frames, int) for name in ("episode_index", "task_index")}
    episode = {"episode_index": [0], "length": [frames], "data/chunk_index": [0], "data/file_index": [0]}
    for camera in CAMERAS:
        episode |= {f"videos/{camera}/{part}_index": [0] for part in ("chunk", "file")}
        episode |= {f"videos/{camera}/from_timestamp": [0.0]}
    for name, table in (("data", numbers | whole | zeros), ("meta/episodes", episode)):
        (folder / name / "chunk-000").mkdir(parents=True)
        pq.write_table(pa.table(table), folder / name / "chunk-000" / "file-000.parquet")
    joints = {"dtype": "float32", "shape": [len(JOINTS)], "names": [f"{name}.pos" for name in JOINTS]}
    film = {"dtype": "video", "shape": [HEIGHT, WIDTH, 3], "names": ["height", "width", "channels"]}
    info = {
        "codebase_version": "v3.0",
        "robot_type": "so101_follower",
        "total_episodes": 1,
        "fps": RATE,
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
        "features": {"action": joints, "observation.state": joints} | dict.fromkeys(CAMERAS, film),
    }
    (folder / "meta/info.json").write_text(json.dumps(info))


def time_call(call: Callable[[], object]) -> tuple[float, float]:
    """Time and time of the processor [s]."""
    began, worked = time.perf_counter(), time.process_time()
    call()
    return time.perf_counter() - began, time.process_time() - worked


def main(seconds: float) -> None:
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "arm"
        make_dataset(folder, round(seconds * RATE))
        chosen = LerobotConfig(CAMERAS[0], ["action"], episodes=None, joint_unit=None)
        calls = {
            "inspect": lambda: describe_lerobot(survey_lerobot(folder)),
            "trajectory": lambda: read_lerobot_trajectory(folder),
            "one camera": lambda: read_lerobot(folder, chosen, FrameSettings(size=FRAME)),
        }
        print(f"an episode of {seconds:g} s; time [s], time of the processor [s]")
        for name, call in calls.items():
            print(f"{name:<12}", *(f"{value:.2f}" for value in time_call(call)))


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 60.0)
