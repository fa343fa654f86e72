"""Whether a stretch is driven and moves as a sim's own recordings do somewhere.

A fitted law tells what it was fitted to. A sudden release, where it only ever saw slow drives, it tells by
chance, and what it then has wrong passes for an effect.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.spatial import KDTree

from lagsplat.diagnose.record import Record, Windows

RARE = 0.999
"""Quantile, over own stretches, of the distance to the next one, beyond which a stretch is not familiar."""


@dataclass(frozen=True)
class Familiar:
    """Own stretches as points: means and deviations of what they show, each over its own spread."""

    middle: Float64[np.ndarray, " f"]
    spread: Float64[np.ndarray, " f"]
    points: KDTree
    reach: float

    @classmethod
    def of(cls, windows: Windows, smooth: Float64[np.ndarray, "N d"], record: Record) -> "Familiar":
        """Those of own recordings."""
        points = looks(windows, smooth, record)
        middle, spread = points.mean(axis=0), np.maximum(points.std(axis=0), 1e-12)
        tree = KDTree((points - middle) / spread)
        apart = tree.query(tree.data, k=2)[0][:, 1]
        return cls(middle, spread, tree, float(np.quantile(apart, RARE)))

    def among(
        self, windows: Windows, smooth: Float64[np.ndarray, "N d"], record: Record
    ) -> Bool[np.ndarray, " W"]:
        """Which of the stretches of another recording are like one of them."""
        points = (looks(windows, smooth, record) - self.middle) / self.spread
        return self.points.query(points)[0] <= self.reach

    def nearest(
        self, wanted: Float64[np.ndarray, "W f"], offered: Float64[np.ndarray, "V f"]
    ) -> Int64[np.ndarray, " W"]:
        """To each of some stretches (`looks`) the one that is most like it among others."""
        tree = KDTree((offered - self.middle) / self.spread)
        return np.asarray(tree.query((wanted - self.middle) / self.spread)[1], dtype=np.int64)


def looks(windows: Windows, smooth: Float64[np.ndarray, "N d"], record: Record) -> Float64[np.ndarray, "W f"]:
    """Mean and standard deviation of coordinates, velocities and inputs over every window."""
    told = [windows.take(values) for values in (smooth, record.v, record.u)]
    return np.concatenate([f(values, axis=1) for values in told for f in (np.mean, np.std)], axis=1)
