"""Windows that a fitted model should not be judged by: novel motion, and outliers among its own recordings.

A model that was identified from recordings is reliable only for motion that resembles them: its error in a
sudden release, after slow drives alone, would be mistaken for a missing effect. And an unrecorded
disturbance, as a push by hand, in a window of a simulator's own recordings spoils the whole fit.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.spatial import KDTree

from lagsplat.diagnose.core.config import NOVELTY
from lagsplat.diagnose.estimation.dataset import Dataset, WindowSet
from lagsplat.diagnose.estimation.multiple_shooting import measure_windows
from lagsplat.diagnose.identification.structure_search import IdentifiedModel


@dataclass(frozen=True)
class KnownRegion:
    """The ball of coordinates in which a law was fitted; its polynomials mean nothing far outside."""

    center: Float64[np.ndarray, " d"]
    radius: float
    room: float  # how far outside, as a share of the radius, the law is still defined [1]

    def measure_distance(self, q: Float64[np.ndarray, "*n d"]) -> Float64[np.ndarray, "*n"]:
        """Distance from the center, as a share of the radius."""
        return np.asarray(np.linalg.norm(q - self.center, axis=-1)) / self.radius

    def find_inside(
        self, recorded: Float64[np.ndarray, "W L d"], predicted: Float64[np.ndarray, "W L d"]
    ) -> Bool[np.ndarray, " W"]:
        """Which windows are recorded in the ball or within half the room, and predicted within the room.

        The ball encloses smoothed states: a recording that begins where that of the fit did begins outside.
        """
        inside = self.measure_distance(recorded).max(axis=1) <= 1.0 + 0.5 * self.room
        return inside & (self.measure_distance(predicted).max(axis=1) <= 1.0 + self.room)


@dataclass(frozen=True)
class NoveltyDetector:
    """A simulator's own windows as points in a space of standardised features."""

    mean: Float64[np.ndarray, " f"]  # means of the features
    spread: Float64[np.ndarray, " f"]  # standard deviations of the features
    points: KDTree  # the standardised features of the windows
    max_distance: float  # distance to the nearest point beyond which a window is novel

    @classmethod
    def from_recordings(cls, windows: WindowSet, dataset: Dataset) -> "NoveltyDetector":
        """The detector of a simulator whose recordings are ``dataset``."""
        points = window_features(windows, dataset)
        mean, spread = points.mean(axis=0), np.maximum(points.std(axis=0), 1e-12)
        tree = KDTree((points - mean) / spread)
        distance = tree.query(tree.data, k=2)[0][:, 1]  # the nearest is the point itself
        return cls(mean, spread, tree, float(np.quantile(distance, NOVELTY.distance_quantile)))

    def find_similar(self, windows: WindowSet, dataset: Dataset) -> Bool[np.ndarray, " W"]:
        """Which windows of another recording resemble a window of the simulator."""
        points = (window_features(windows, dataset) - self.mean) / self.spread
        return self.points.query(points)[0] <= self.max_distance

    def find_nearest(
        self, wanted: Float64[np.ndarray, "W f"], offered: Float64[np.ndarray, "V f"]
    ) -> Int64[np.ndarray, " W"]:
        """For each row of features (`window_features`) the index of the most similar row of ``offered``."""
        tree = KDTree((offered - self.mean) / self.spread)
        return np.asarray(tree.query((wanted - self.mean) / self.spread)[1], dtype=np.int64)


def window_features(windows: WindowSet, dataset: Dataset) -> Float64[np.ndarray, "W f"]:
    """Mean and standard deviation of coordinates, velocities and inputs over every window."""
    signals = [windows.take(values) for values in (dataset.smooth, dataset.v, dataset.u)]
    return np.concatenate([f(values, axis=1) for values in signals for f in (np.mean, np.std)], axis=1)


def drop_outlier_windows(
    identified: IdentifiedModel,
    refit: Callable[[IdentifiedModel, WindowSet], IdentifiedModel],
    identify: Callable[[WindowSet], IdentifiedModel],
) -> tuple[IdentifiedModel, WindowSet]:
    """Identify a model again without its windows of largest residual, if the rest then fits far better.

    They are left out one by one, the model being refitted after each.

    Returns:
        ``identified`` or the model without the outliers, and the windows that were left out.
    """
    windows, best, n = identified.windows, identified, len(identified.windows.first)
    kept, poor = np.arange(n), identified.misfit > NOVELTY.poor_misfit and n >= NOVELTY.min_windows
    for _ in range(min(NOVELTY.max_outliers, n // NOVELTY.min_windows_per_outlier) if poor else 0):
        misfits = measure_windows(best.fit.residual, best.windows.length)
        worst = int(np.argmax(misfits))
        if best.misfit < NOVELTY.good_misfit or misfits[worst] < NOVELTY.outlier_ratio * np.median(misfits):
            break
        kept = np.delete(kept, worst)
        best = refit(best, windows.select(kept))
    if best.misfit < NOVELTY.max_remaining_share * identified.misfit:
        return identify(windows.select(kept)), windows.select(np.setdiff1d(np.arange(n), kept))
    return identified, windows.select(np.zeros(0, dtype=np.int64))
