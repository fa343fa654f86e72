"""A run whose Gaussians live in space: every visitor looks from a side of their own."""

import numpy as np
import viser
from jaxtyping import Float64


def draw_lines(
    scene: viser.SceneApi, name: str, points: np.ndarray, color: tuple[int, int, int], *, thick: float
) -> viser.LineSegmentsHandle:
    """Hidden line segments (N, 2, 3) of a scene, as thick as told in its unit."""
    return scene.add_line_segments(name, points.astype(np.float32), color, thickness=thick, visible=False)


def to_segments(line: Float64[np.ndarray, "n k"]) -> Float64[np.ndarray, "m 2 k"]:
    """A line through corners as segments."""
    return np.stack([line[:-1], line[1:]], axis=1)


REST = (64, 196, 255)
