"""What was pushed and what happened: one row a step, of which the last ones are kept.

What the recording offers an interactive session: states to start from, and inputs to replay.

Whether a state is one the recording covered: what lies beyond was never seen, and is the law's guess.
"""

from collections import deque
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float64, Int64

from lagsplat.chart.chart import Chart
from lagsplat.stage2.lagrangian import LawEdits


@dataclass(frozen=True)
class SessionHistory:
    """Rows of a session, ``dt_s`` apart; row ``i`` is the state before the step that row ``i`` drove.

    ``clip`` counts the resets before a row, where the state jumps. ``force`` [energy of the law per px]
    acts at ``place`` [px], NaN where nothing is held; ``load`` is the same pulled back. ``edits`` are the
    factors of damping, inertia and stiffness.
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
    """Kinetic, potential, work of the hand, work of the inputs, dissipated."""

    def __len__(self) -> int:
        return len(self.q)

    @property
    def time_s(self) -> Float64[np.ndarray, " N"]:
        """Instants of the rows, the first at 0."""
        return self.dt_s * np.arange(len(self))

    @property
    def segments(self) -> tuple[tuple[int, int], ...]:
        """Rows between resets, half-open."""
        cuts = [0, *(1 + np.flatnonzero(np.diff(self.clip))).tolist(), len(self)]
        return tuple((a, b) for a, b in pairwise(cuts) if a < b)

    def edits_at(self, row: int) -> LawEdits:
        """The edits of a row."""
        damping, inertia, stiffness = (float(x) for x in self.edits[row])
        return LawEdits(damping=damping, inertia=inertia, stiffness=stiffness)


class HistoryBuffer:
    """Keeps the last ``rows`` rows; older ones are dropped, so that memory is bounded."""

    def __init__(self, *, d: int, n_u: int, space: int, dt_s: float, rows: int) -> None:
        self.d, self.n_u, self.space, self.dt_s = d, n_u, space, dt_s
        self.rows: deque[np.ndarray] = deque(maxlen=max(1, rows))

    def __len__(self) -> int:
        return len(self.rows)

    def add(self, clip: int, *parts: np.ndarray) -> None:
        """One row: the parts of `SessionHistory` in their order, after ``clip``."""
        self.rows.append(np.concatenate([[clip], *parts]))

    def read(self) -> SessionHistory:
        """What is kept.

        Raises:
            ValueError: nothing happened yet.
        """
        if not self.rows:
            raise ValueError("nothing has been recorded yet: let the simulation run, push it, and save again")
        table = np.stack(list(self.rows))
        widths = [1, self.d, self.d, self.n_u, self.d, self.space, self.space, 3, 5]
        clip, *parts = np.split(table, np.cumsum(widths)[:-1], axis=1)
        return SessionHistory(self.dt_s, clip[:, 0].astype(np.int64), *(part.copy() for part in parts))


@dataclass(frozen=True)
class RecordedData:
    """Smoothed states, velocities [1/s] and inputs of every frame; ``segments`` are its clips.

    A clip of one frame has velocity zero. ``names`` and ``units`` are those of the inputs.
    """

    q: Float64[np.ndarray, "T d"]
    v: Float64[np.ndarray, "T d"]
    u: Float64[np.ndarray, "T n_u"]
    segments: tuple[tuple[int, int], ...]
    names: tuple[str, ...]
    units: tuple[str, ...]

    @property
    def frames(self) -> int:
        """How many there are."""
        return len(self.q)

    def after(self, frame: int) -> int:
        """The next frame of the same clip; after its last one the clip begins again."""
        start, stop = next((a, b) for a, b in self.segments if a <= frame < b)
        return frame + 1 if frame + 1 < stop else start

    def require(self, frame: int) -> int:
        """``frame``, if it is one of a clip.

        Raises:
            ValueError: it is not.
        """
        if not any(a <= frame < b for a, b in self.segments):
            raise ValueError(f"frame {frame} is not in the recording of frames 0 to {self.frames - 1}")
        return frame


def read_recorded_data(chart: Chart, *, names: tuple[str, ...], units: tuple[str, ...]) -> RecordedData:
    """The whole recording, smoothed as the dynamics were fitted; velocities are central differences."""
    whole = chart.whole.smoothed(chart.smoothing_frames)
    v = np.zeros_like(whole.latents)
    for a, b in whole.segments:
        if b - a > 1:
            v[a:b] = np.gradient(whole.latents[a:b], whole.time_s[a:b], axis=0)
    return RecordedData(whole.latents, v, whole.inputs, whole.segments, names, units)


POINTS = 400
"""States that stand for all of the training part; they are spread by always adding the farthest one."""


@dataclass(frozen=True)
class TrainingCoverage:
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


def measure_coverage(chart: Chart, *, beyond: float) -> TrainingCoverage:
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
    return TrainingCoverage(seen[chosen], root, float(left.max()) + beyond * spread)
