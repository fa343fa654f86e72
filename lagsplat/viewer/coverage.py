"""Whether a state is one the recording covered: what lies beyond was never seen, and is the law's guess."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from lagsplat.chart.chart import Chart

POINTS = 400
"""States that stand for all of the training part; they are spread by always adding the farthest one."""


@dataclass(frozen=True)
class Coverage:
    """Balls of one ``radius`` around ``points`` (n, d), in coordinates ``q @ root`` in which a distance is a
    change of the picture.
    """

    points: Float64[np.ndarray, "n d"]
    root: Float64[np.ndarray, "d d"]
    radius: float

    def distance(self, q: Float64[np.ndarray, " d"]) -> float:
        """From the nearest known state, in radii: beyond 1 the recording never was."""
        away = self.points - q @ self.root
        return float(np.sqrt(np.square(away).sum(1).min()) / self.radius)


def coverage_of(chart: Chart, *, beyond: float) -> Coverage:
    """What the training states cover; ``beyond`` is a share of their rms spread that is granted around
    them."""
    values, vectors = np.linalg.eigh(chart.metric)
    root = vectors * np.sqrt(np.clip(values, 0.0, None))
    seen = chart.train.latents @ root
    spread = float(np.sqrt(np.square(seen - seen.mean(0)).sum(1).mean()))
    chosen, left = [0], np.linalg.norm(seen - seen[0], axis=1)
    while len(chosen) < min(POINTS, len(seen)):
        chosen.append(int(left.argmax()))
        left = np.minimum(left, np.linalg.norm(seen - seen[chosen[-1]], axis=1))
    return Coverage(seen[chosen], root, float(left.max()) + beyond * spread)
