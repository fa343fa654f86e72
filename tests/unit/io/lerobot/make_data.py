"""Write ``data/v21`` and ``data/v30`` by LeRobot's own writer, which is not needed to run the tests.

Usage: ``python tests/unit/io/lerobot/make_data.py FOLDER``. LeRobot 0.3.3 writes version 2.1 and LeRobot
0.4.4 version 3.0, so that it is run once with each. The writer imports torchvision and does not use its
compiled operators; where these do not load, they are declared here, without a body.
"""

import contextlib
import sys
from pathlib import Path

import cv2
import numpy as np
import torch

with contextlib.suppress(RuntimeError):
    declared = torch.library.Library("torchvision", "DEF")
    for operator in ("nms", "qnms"):
        declared.define(f"{operator}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")

from lerobot.datasets.lerobot_dataset import CODEBASE_VERSION, LeRobotDataset

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
FPS, LENGTHS = 30, (60, 45)
HEIGHT, WIDTH = 48, 64
CAMERAS = ("observation.images.front", "observation.images.wrist")


def draw_square(step: int, episode: int) -> np.ndarray:
    """A bright square that moves to the right by a pixel a frame, in a row of its own for each episode."""
    picture = np.full((HEIGHT, WIDTH, 3), 40, np.uint8)
    left = step % (WIDTH - 12)
    cv2.rectangle(picture, (left, 8 + 16 * episode), (left + 11, 19 + 16 * episode), (230, 230, 230), -1)
    return picture


def main(folder: Path) -> None:
    names = [f"{joint}.pos" for joint in JOINTS]
    joints = {"dtype": "float32", "shape": (len(names),), "names": names}
    picture = {"dtype": "video", "shape": (HEIGHT, WIDTH, 3), "names": ["height", "width", "channels"]}
    dataset = LeRobotDataset.create(
        "local/arm",
        fps=FPS,
        root=folder,
        robot_type="so100_follower",
        features={"action": joints, "observation.state": joints} | dict.fromkeys(CAMERAS, picture),
    )
    rng = np.random.default_rng(0)
    for episode, length in enumerate(LENGTHS):
        time_s = np.arange(length) / FPS
        phases = rng.uniform(0.0, 2.0 * np.pi, len(names))
        # degrees beyond 100, as only a log in degrees has them; a gripper from 0 to 100
        targets = 120.0 * np.sin(2.0 * np.pi * 0.5 * time_s[:, None] + phases)
        targets[:, -1] = 50.0 + 40.0 * np.sin(2.0 * np.pi * time_s)
        states = targets[0] + np.zeros_like(targets)
        for step in range(1, length):
            states[step] = states[step - 1] + 0.3 * (targets[step - 1] - states[step - 1])
        for step in range(length):
            frame = {"action": targets[step].astype(np.float32)}
            frame["observation.state"] = states[step].astype(np.float32)
            frame |= {camera: draw_square(step, episode) for camera in CAMERAS}
            if CODEBASE_VERSION == "v2.1":
                dataset.add_frame(frame, task="wave")
            else:
                dataset.add_frame({**frame, "task": "wave"})
        dataset.save_episode()
    if hasattr(dataset, "finalize"):
        dataset.finalize()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
