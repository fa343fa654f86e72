"""Whether a stretch is driven and moves as a sim's own recordings do somewhere.

A fitted law tells what it was fitted to. A sudden release, where it only ever saw slow drives, it tells by
chance, and what it then has wrong passes for an effect.

A sim's own recordings in which something acted that no column tells, as a push by hand: told without it.

A law that has to tell such a stretch as well tells none. The stretch that it misses most is left out, and the
law found anew; where that one tells the rest far better, it was the stretch that was wrong, and not the law.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.spatial import KDTree

from lagsplat.diagnose.estimation.dataset import Dataset, WindowSet
from lagsplat.diagnose.identification.structure_search import IdentifiedModel

NOVELTY_QUANTILE = 0.999
"""Quantile, over own stretches, of the distance to the next one, beyond which a stretch is not familiar."""


@dataclass(frozen=True)
class NoveltyDetector:
    """Own stretches as points: means and deviations of what they show, each over its own spread."""

    middle: Float64[np.ndarray, " f"]
    spread: Float64[np.ndarray, " f"]
    points: KDTree
    reach: float

    @classmethod
    def from_recordings(
        cls, windows: WindowSet, smooth: Float64[np.ndarray, "N d"], record: Dataset
    ) -> "NoveltyDetector":
        """Those of own recordings."""
        points = window_features(windows, smooth, record)
        middle, spread = points.mean(axis=0), np.maximum(points.std(axis=0), 1e-12)
        tree = KDTree((points - middle) / spread)
        apart = tree.query(tree.data, k=2)[0][:, 1]
        return cls(middle, spread, tree, float(np.quantile(apart, NOVELTY_QUANTILE)))

    def find_similar(
        self, windows: WindowSet, smooth: Float64[np.ndarray, "N d"], record: Dataset
    ) -> Bool[np.ndarray, " W"]:
        """Which of the stretches of another recording are like one of them."""
        points = (window_features(windows, smooth, record) - self.middle) / self.spread
        return self.points.query(points)[0] <= self.reach

    def find_nearest(
        self, wanted: Float64[np.ndarray, "W f"], offered: Float64[np.ndarray, "V f"]
    ) -> Int64[np.ndarray, " W"]:
        """To each of some stretches (`window_features`) the one that is most like it among others."""
        tree = KDTree((offered - self.middle) / self.spread)
        return np.asarray(tree.query((wanted - self.middle) / self.spread)[1], dtype=np.int64)


def window_features(
    windows: WindowSet, smooth: Float64[np.ndarray, "N d"], record: Dataset
) -> Float64[np.ndarray, "W f"]:
    """Mean and standard deviation of coordinates, velocities and inputs over every window."""
    told = [windows.take(values) for values in (smooth, record.v, record.u)]
    return np.concatenate([f(values, axis=1) for values in told for f in (np.mean, np.std)], axis=1)


POOR_MISFIT = 4.0
"""Mean square residual, in that of the noise, above which it is asked."""
GOOD_MISFIT = 1.5
"""The same, below which all that is left is told."""
OUTLIER_RATIO = 4.0
"""Times the middle window's mean square by which one is missed that is left out."""
MAX_REMAINING_SHARE = 0.25
"""Share of the mean square that the others must leave at most."""
MAX_OUTLIERS = 3
"""Windows that are left out at most."""
MIN_WINDOWS_PER_OUTLIER = 4
"""At most one window in this many is left out."""
MIN_WINDOWS = 8
"""Fewer windows than this stay as they are: the median of fewer says little of what is usual."""


def drop_outlier_windows(
    found: IdentifiedModel, again: Callable[[WindowSet], IdentifiedModel]
) -> tuple[IdentifiedModel, WindowSet]:
    """``found``, or what ``again`` finds on fewer of its windows, and the windows that were left out."""
    windows, best, n = found.windows, found, len(found.windows.first)
    kept = np.arange(n)
    for _ in range(
        min(MAX_OUTLIERS, n // MIN_WINDOWS_PER_OUTLIER)
        if found.misfit > POOR_MISFIT and n >= MIN_WINDOWS
        else 0
    ):
        missed = compute_window_misfits(best)
        worst = int(np.argmax(missed))
        if best.misfit < GOOD_MISFIT or missed[worst] < OUTLIER_RATIO * np.median(missed):
            break
        kept = np.delete(kept, worst)
        best = again(windows.select(kept))
    if best.misfit < MAX_REMAINING_SHARE * found.misfit:
        return best, windows.select(np.setdiff1d(np.arange(n), kept))
    return found, windows.select(np.zeros(0, dtype=np.int64))


def compute_window_misfits(found: IdentifiedModel) -> Float64[np.ndarray, " W"]:
    """Mean square of every window's residual, in that of the noise."""
    length: Int64[np.ndarray, " W"] = found.windows.length
    return np.array([float((row[:n] ** 2).mean()) for row, n in zip(found.fit.residual, length, strict=True)])
