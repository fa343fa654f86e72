"""Data of a session: its history, the recording to start from, and the states that the recording covers."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float64, Int64

from lagsplat.array_types import Vector
from lagsplat.chart.chart import Chart
from lagsplat.stage2.lagrangian import LawEdits


@dataclass(frozen=True)
class SessionHistory:
    """The last steps of a session, ``dt_s`` apart; row ``i`` holds the state before step ``i``.

    ``clip`` counts the resets before a row, where the state jumps. ``force`` [energy of the law per px] acts
    at ``place`` [px], which is NaN where nothing is grasped; ``load`` is its generalised force. ``edits``
    are the factors of damping, inertia and stiffness.
    """

    dt_s: float
    clip: Int64[np.ndarray, " N"]
    q: Float64[np.ndarray, "N d"]
    v: Float64[np.ndarray, "N d"]
    u: Float64[np.ndarray, "N n_u"]
    load: Float64[np.ndarray, "N d"]
    force: Float64[np.ndarray, "N n"]
    place: Float64[np.ndarray, "N n"]
    edits: Float64[np.ndarray, "N 3"]
    energy: Float64[np.ndarray, "N 5"]
    """Kinetic, potential, work of the hand, work of the inputs and dissipated energy."""

    def __len__(self) -> int:
        return len(self.q)

    @property
    def time_s(self) -> Float64[np.ndarray, " N"]:
        """Times of the rows [s]; the first is 0."""
        return self.dt_s * np.arange(len(self))

    @property
    def segments(self) -> tuple[tuple[int, int], ...]:
        """Half-open ranges of rows between two resets."""
        cuts = [0, *(1 + np.flatnonzero(np.diff(self.clip))).tolist(), len(self)]
        return tuple((a, b) for a, b in pairwise(cuts) if a < b)

    def edits_at(self, row: int) -> LawEdits:
        """The edits of the law at a row."""
        return LawEdits(*self.edits[row].tolist())


class HistoryBuffer:
    """Ring buffer of the last ``rows`` steps; the first takes the memory of all, so that it stays flat."""

    def __init__(self, *, dt_s: float, rows: int) -> None:
        self.dt_s, self.rows, self.added = dt_s, max(1, rows), 0
        self.widths, self.table = [1], np.empty((0, 1))

    def __len__(self) -> int:
        return min(self.added, self.rows)

    def add(self, clip: int, *parts: np.ndarray) -> None:
        """Append a row: ``clip`` and the other columns of `SessionHistory` in their order."""
        if not self.added:
            self.widths = [1, *(len(part) for part in parts)]
            self.table = np.full((self.rows, sum(self.widths)), np.nan)
        self.table[self.added % self.rows] = np.concatenate([[clip], *parts])
        self.added += 1

    def read(self) -> SessionHistory:
        """The stored rows as arrays.

        Raises:
            ValueError: the buffer is empty.
        """
        if not self.added:
            raise ValueError("nothing has been recorded yet: let the simulation run, push it, and save again")
        oldest = self.added % self.rows if self.added > self.rows else 0
        table = np.roll(self.table[: len(self)], -oldest, axis=0)
        clip, *parts = np.split(table, np.cumsum(self.widths)[:-1], axis=1)
        return SessionHistory(self.dt_s, clip[:, 0].astype(np.int64), *(part.copy() for part in parts))


@dataclass(frozen=True)
class RecordedData:
    """Smoothed states, velocities [1/s] and inputs of every recorded frame; ``segments`` are the clips.

    The velocity of a clip of one frame is zero. ``names`` and ``units`` belong to the inputs.
    """

    q: Float64[np.ndarray, "T d"]
    v: Float64[np.ndarray, "T d"]
    u: Float64[np.ndarray, "T n_u"]
    segments: tuple[tuple[int, int], ...]
    names: tuple[str, ...]
    units: tuple[str, ...]

    def next_frame(self, frame: int) -> int:
        """The next frame of the same clip; its first one after its last."""
        start, stop = next((a, b) for a, b in self.segments if a <= frame < b)
        return frame + 1 if frame + 1 < stop else start


def read_recorded_data(chart: Chart, *, names: tuple[str, ...], units: tuple[str, ...]) -> RecordedData:
    """Read the recording of a chart, smoothed as for the fit; velocities are central differences."""
    whole = chart.whole.smoothed(chart.smoothing_frames)
    v = np.zeros_like(whole.latents)
    for a, b in whole.segments:
        if b - a > 1:
            v[a:b] = np.gradient(whole.latents[a:b], whole.time_s[a:b], axis=0)
    return RecordedData(whole.latents, v, whole.inputs, whole.segments, names, units)


POINTS = 400  # number of states that represent the training part, chosen by farthest-point sampling


@dataclass(frozen=True)
class TrainingCoverage:
    """The states that the recording covers: balls of ``radius`` around ``points`` (n, d).

    Points and radius are in coordinates ``q @ root``, where a distance is a change of the image.
    """

    points: Float64[np.ndarray, "n d"]
    root: Float64[np.ndarray, "d d"]
    radius: float

    def distance(self, q: Vector) -> float:
        """Distance of ``q`` from the nearest covered point in radii; above 1 it is outside the recording."""
        away = self.points - q @ self.root
        return float(np.sqrt(np.square(away).sum(1).min()) / self.radius)


def measure_coverage(chart: Chart, *, beyond: float) -> TrainingCoverage:
    """Measure what the training states cover, with a margin of ``beyond`` times their rms spread."""
    values, vectors = np.linalg.eigh(chart.metric)
    root = vectors * np.sqrt(np.clip(values, 0.0, None))
    states = chart.train.latents @ root
    spread = float(np.sqrt(np.square(states - states.mean(0)).sum(1).mean()))
    chosen, distance = [0], np.linalg.norm(states - states[0], axis=1)
    while len(chosen) < min(POINTS, len(states)):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(states - states[chosen[-1]], axis=1))
    return TrainingCoverage(states[chosen], root, float(distance.max()) + beyond * spread)
