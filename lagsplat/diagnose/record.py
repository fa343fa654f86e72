"""What a simulation is held against: motions joined clip by clip, cut into windows."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from lagsplat.io.motion import Motion

BREAK_S = 10.0
"""Between files whose own clocks do not go on from one to the next."""


@dataclass(frozen=True)
class Record:
    """Files joined along one clock: ``time`` (N,) [s] counts from the first's start; clips never touch."""

    time: Float64[np.ndarray, " N"]
    q: Float64[np.ndarray, "N d"]
    v: Float64[np.ndarray, "N d"]
    """Velocity estimates to start from [1/s]; see `lagsplat.diagnose.noise.local_cubic`."""
    u: Float64[np.ndarray, "N n_u"]
    clips: Int64[np.ndarray, "C 2"]
    files: tuple[str, ...]
    file_of: Int64[np.ndarray, " C"]
    """Number of the file of each clip."""
    shifts_s: tuple[float, ...]
    """What each file's own clock shows at zero of the joint one [s]."""

    @property
    def d(self) -> int:
        """Number of coordinates."""
        return self.q.shape[1]

    @property
    def dt_s(self) -> float:
        """Median time between frames [s]."""
        return float(np.median(np.concatenate([np.diff(self.time[a:b]) for a, b in self.clips])))

    def own_time(self, time_s: float) -> tuple[int, float]:
        """The file that an instant of the joint clock falls into or after, and its own clock then [s]."""
        begun = self.time[self.clips[:, 0]] <= time_s
        number = int(self.file_of[np.flatnonzero(begun)[-1]]) if begun.any() else 0
        return number, time_s + self.shifts_s[number]


@dataclass(frozen=True)
class Span:
    """A stretch of a file, by the file's own clock [s]."""

    file: str
    start_s: float
    stop_s: float

    def meets(self, other: "Span") -> bool:
        """Whether both hold more than a border."""
        return self.file == other.file and self.start_s < other.stop_s and other.start_s < self.stop_s


@dataclass(frozen=True)
class Windows:
    """Stretches of a record that are simulated each from a state of its own."""

    first: Int64[np.ndarray, " W"]
    length: Int64[np.ndarray, " W"]

    @property
    def longest(self) -> int:
        """Frames of the longest window."""
        return int(self.length.max())

    def mask(self) -> Float64[np.ndarray, "W L"]:
        """One where a window has a frame, zero beyond its end."""
        return (np.arange(self.longest)[None, :] < self.length[:, None]).astype(np.float64)

    def take(self, values: np.ndarray) -> np.ndarray:
        """Samples (W, L, ...) of the windows; beyond a window's end its last one stands."""
        index = self.first[:, None] + np.minimum(np.arange(self.longest)[None, :], self.length[:, None] - 1)
        return values[index]

    def only(self, chosen: np.ndarray) -> "Windows":
        """Those of the windows that are ``chosen``, a mask or an index."""
        return Windows(self.first[chosen], self.length[chosen])

    def evenly(self, frames: float) -> "Windows":
        """As many of the windows, evenly apart, as hold about ``frames`` frames; all if these are fewer."""
        total, n = float(self.length.sum()), len(self.first)
        if frames >= total:
            return self
        return self.only(np.unique(np.linspace(0, n - 1, max(round(n * frames / total), 4)).astype(int)))


def spans(windows: Windows, record: Record) -> tuple[Span, ...]:
    """Where the windows lie in the files of their record."""
    out = []
    for first, length in zip(windows.first, windows.length, strict=True):
        number, start_s = record.own_time(float(record.time[first]))
        stop_s = float(record.time[first + length - 1]) + record.shifts_s[number]
        out.append(Span(record.files[number], start_s, stop_s))
    return tuple(out)


def apart(windows: Windows, record: Record, others: Sequence[Span]) -> Windows:
    """Those of the windows that meet none of ``others``."""
    met = [any(one.meets(other) for other in others) for one in spans(windows, record)]
    return windows.only(~np.array(met, dtype=bool))


def join(motions: Sequence[Motion], velocities: Sequence[np.ndarray]) -> Record:
    """One record of ``motions`` with their velocity estimates."""
    clips, file_of, offset, shifts = [], [], 0, clock_shifts(motions)
    for number, motion in enumerate(motions):
        for start, stop in motion.segments:
            clips.append((offset + start, offset + stop))
            file_of.append(number)
        offset += motion.n
    return Record(
        time=np.concatenate([m.time_s - shift for m, shift in zip(motions, shifts, strict=True)]),
        q=np.concatenate([m.q for m in motions]),
        v=np.concatenate(list(velocities)),
        u=np.concatenate([m.u for m in motions]),
        clips=np.array(clips, dtype=np.int64),
        files=tuple(m.source for m in motions),
        file_of=np.array(file_of, dtype=np.int64),
        shifts_s=shifts,
    )


def clock_shifts(motions: Sequence[Motion]) -> tuple[float, ...]:
    """What each file's own clock shows at zero of a joint one [s], which starts with the first file.

    Files whose clocks go on from one to the next keep them, where no pause is longer than all that was
    recorded; others follow each other after a break.
    """
    first, last = (np.array([m.time_s[i] for m in motions]) for i in (0, -1))
    pauses = first[1:] - last[:-1]
    if ((pauses > 0.0) & (pauses < (last - first).sum())).all():
        return (float(first[0]),) * len(motions)
    begins = np.append(0.0, np.cumsum(last - first + BREAK_S)[:-1])
    return tuple((first - begins).tolist())


def cut_windows(record: Record, *, length_s: float, least: int) -> Windows:
    """Windows of about ``length_s``, end to end, none across a cut and none below ``least`` frames.

    Neighbours share their border frame.
    """
    first, length = [], []
    for start, stop in record.clips:
        span = record.time[stop - 1] - record.time[start]
        wanted = max(1, int(span / length_s + 0.5))
        number = max(1, min(wanted, (stop - start - 1) // max(least - 1, 1)))
        if stop - start < least:
            continue
        borders = np.round(np.linspace(start, stop - 1, number + 1)).astype(int)
        first += borders[:-1].tolist()
        length += (np.diff(borders) + 1).tolist()
    if not first:
        raise ValueError(f"no clip has {least} frames; record longer stretches without a cut")
    return Windows(np.array(first, dtype=np.int64), np.array(length, dtype=np.int64))
