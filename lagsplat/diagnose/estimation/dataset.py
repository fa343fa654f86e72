"""What a simulation is held against: motions joined clip by clip, cut into windows.

The inputs at every instant at which a rollout asks for them.

From motions to a record that can be shot through: noise, velocities and natural period.

Where a mechanism was seen: the states and inputs at which a sim that is given pointwise is asked.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64, Int64

from lagsplat.diagnose.data_quality.noise import estimate_noise_level, fit_local_cubic
from lagsplat.io.trajectory.trajectory import Trajectory

FILE_BREAK_S = 10.0
"""Between files whose own clocks do not go on from one to the next."""


@dataclass(frozen=True)
class Dataset:
    """Files joined along one clock: ``time`` (N,) [s] counts from the first's start; clips never touch."""

    time: Float64[np.ndarray, " N"]
    q: Float64[np.ndarray, "N d"]
    v: Float64[np.ndarray, "N d"]
    """Velocity estimates to start from [1/s]; see `lagsplat.diagnose.data_quality.noise.fit_local_cubic`."""
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

    def to_file_time(self, time_s: float) -> tuple[int, float]:
        """The file that an instant of the joint clock falls into or after, and its own clock then [s]."""
        begun = self.time[self.clips[:, 0]] <= time_s
        number = int(self.file_of[np.flatnonzero(begun)[-1]]) if begun.any() else 0
        return number, time_s + self.shifts_s[number]


@dataclass(frozen=True)
class FileSpan:
    """A stretch of a file, by the file's own clock [s]."""

    file: str
    start_s: float
    stop_s: float

    def overlaps(self, other: "FileSpan") -> bool:
        """Whether both hold more than a border."""
        return self.file == other.file and self.start_s < other.stop_s and other.start_s < self.stop_s


@dataclass(frozen=True)
class WindowSet:
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

    def select(self, chosen: np.ndarray) -> "WindowSet":
        """Those of the windows that are ``chosen``, a mask or an index."""
        return WindowSet(self.first[chosen], self.length[chosen])

    def subsample(self, frames: float) -> "WindowSet":
        """As many of the windows, evenly apart, as hold about ``frames`` frames; all if these are fewer."""
        total, n = float(self.length.sum()), len(self.first)
        if frames >= total:
            return self
        return self.select(np.unique(np.linspace(0, n - 1, max(round(n * frames / total), 4)).astype(int)))


def locate_windows(windows: WindowSet, record: Dataset) -> tuple[FileSpan, ...]:
    """Where the windows lie in the files of their record."""
    out = []
    for first, length in zip(windows.first, windows.length, strict=True):
        number, start_s = record.to_file_time(float(record.time[first]))
        stop_s = float(record.time[first + length - 1]) + record.shifts_s[number]
        out.append(FileSpan(record.files[number], start_s, stop_s))
    return tuple(out)


def drop_overlapping_windows(windows: WindowSet, record: Dataset, others: Sequence[FileSpan]) -> WindowSet:
    """Those of the windows that meet none of ``others``."""
    met = [any(one.overlaps(other) for other in others) for one in locate_windows(windows, record)]
    return windows.select(~np.array(met, dtype=bool))


def join_trajectories(motions: Sequence[Trajectory], velocities: Sequence[np.ndarray]) -> Dataset:
    """One record of ``motions`` with their velocity estimates."""
    clips, file_of, offset, shifts = [], [], 0, compute_clock_shifts(motions)
    for number, motion in enumerate(motions):
        for start, stop in motion.segments:
            clips.append((offset + start, offset + stop))
            file_of.append(number)
        offset += motion.n
    return Dataset(
        time=np.concatenate([m.time_s - shift for m, shift in zip(motions, shifts, strict=True)]),
        q=np.concatenate([m.q for m in motions]),
        v=np.concatenate(list(velocities)),
        u=np.concatenate([m.u for m in motions]),
        clips=np.array(clips, dtype=np.int64),
        files=tuple(m.source for m in motions),
        file_of=np.array(file_of, dtype=np.int64),
        shifts_s=shifts,
    )


def compute_clock_shifts(motions: Sequence[Trajectory]) -> tuple[float, ...]:
    """What each file's own clock shows at zero of a joint one [s], which starts with the first file.

    Files whose clocks go on from one to the next keep them, where no pause is longer than all that was
    recorded; others follow each other after a break.
    """
    first, last = (np.array([m.time_s[i] for m in motions]) for i in (0, -1))
    pauses = first[1:] - last[:-1]
    if ((pauses > 0.0) & (pauses < (last - first).sum())).all():
        return (float(first[0]),) * len(motions)
    begins = np.append(0.0, np.cumsum(last - first + FILE_BREAK_S)[:-1])
    return tuple((first - begins).tolist())


def cut_windows(record: Dataset, *, length_s: float, least: int) -> WindowSet:
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
    return WindowSet(np.array(first, dtype=np.int64), np.array(length, dtype=np.int64))


@dataclass(frozen=True)
class InputSignal:
    """One input in the order of time: beginning, middle and end of every substep of every frame.

    ``begins`` marks where a clip begins. Between samples of the log it is linear, or held.
    """

    time: Float64[np.ndarray, " M"]
    values: Float64[np.ndarray, " M"]
    begins: Bool[np.ndarray, " M"]
    clip: np.ndarray
    logged: tuple[tuple[np.ndarray, np.ndarray], ...]
    """Times and values of the log, clip by clip."""
    held: bool

    def at(self, time: Float64[np.ndarray, " M"]) -> Float64[np.ndarray, " M"]:
        """The logged input at other instants; outside a clip its nearest sample."""
        out = np.empty(len(time))
        for number, (known, values) in enumerate(self.logged):
            mine = self.clip == number
            if self.held:
                index = np.searchsorted(known, time[mine] + 1e-9, side="right") - 1
                out[mine] = values[np.clip(index, 0, len(values) - 1)]
            else:
                out[mine] = np.interp(time[mine], known, values)
        return out


def compute_stage_times(record: Dataset, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Instants (N, steps, 3) of a rollout's stages and the clip of each frame (N,)."""
    clip = np.zeros(len(record.time), dtype=np.int64)
    ahead = np.zeros(len(record.time))
    for number, (start, stop) in enumerate(record.clips):
        clip[start:stop] = number
        ahead[start : stop - 1] = np.diff(record.time[start:stop])
    share = (np.arange(steps)[:, None] + np.array([0.0, 0.5, 1.0])[None, :]) / steps
    return record.time[:, None, None] + ahead[:, None, None] * share, clip


def build_input_signals(record: Dataset, *, steps: int, held: bool) -> tuple[InputSignal, ...]:
    """The inputs of a record, one signal a channel."""
    time, clip = compute_stage_times(record, steps)
    if held:  # the end of a substep is still under the input that was held during it, however late that acts
        time[:, :, 2] -= 1e-7
    per_frame = time.shape[1] * 3
    flat, clips = time.reshape(-1), np.repeat(clip, per_frame)
    begins = np.zeros(len(flat), dtype=bool)
    begins[record.clips[:, 0] * per_frame] = True
    out = []
    for column in record.u.T:
        logged = tuple((record.time[a:b], np.ascontiguousarray(column[a:b])) for a, b in record.clips)
        blank = InputSignal(flat, np.zeros(len(flat)), begins, clips, logged, held)
        out.append(replace(blank, values=blank.at(flat)))
    return tuple(out)


MIN_RELATIVE_NOISE = 1e-3
"""Noise that is assumed at least, in fractions of the rms: less of a motion is not worth explaining."""


@dataclass(frozen=True)
class PreparedDataset:
    """A record with its smoothed coordinates, accelerations and noise."""

    dataset: Dataset
    smooth: Float64[np.ndarray, "N d"]
    acceleration: Float64[np.ndarray, "N d"]
    sigma: Float64[np.ndarray, " d"]


def prepare_dataset(motions: Sequence[Trajectory], *, period_s: float) -> PreparedDataset:
    """Noise from a local cubic over a seventh of the period, velocities over more if noise is strong."""
    clips = [np.array(m.segments, dtype=np.int64) for m in motions]
    levels = [
        estimate_noise_level(m.time_s, m.q, clip, width_s=0.15 * period_s)
        for m, clip in zip(motions, clips, strict=True)
    ]
    known = np.array([level for level in levels if np.isfinite(level).all()])
    rms = np.std(np.concatenate([m.q for m in motions]), axis=0)
    sigma = np.median(known, axis=0) if len(known) else MIN_RELATIVE_NOISE * rms
    worst = float(np.max(sigma / np.maximum(rms, 1e-300)))
    width = (0.12 if worst < 0.004 else 0.2 if worst < 0.015 else 0.28) * period_s
    cubics = [
        fit_local_cubic(m.time_s, m.q, clip, width_s=width) for m, clip in zip(motions, clips, strict=True)
    ]
    return PreparedDataset(
        join_trajectories(motions, [slope for _, slope, _ in cubics]),
        np.concatenate([smooth for smooth, _, _ in cubics]),
        np.concatenate([bend for _, _, bend in cubics]),
        np.maximum(sigma, MIN_RELATIVE_NOISE * rms),
    )


REGION_MARGIN = 0.15
"""How far beyond what was visited a sim is asked, as a share of half the range."""
REGION_POINTS = 600


@dataclass(frozen=True)
class OperatingRegion:
    """States and inputs, a row each: visited ones, and as many that mix what never came together."""

    q: Float64[np.ndarray, "N d"]
    v: Float64[np.ndarray, "N d"]
    u: Float64[np.ndarray, "N n_u"]

    @property
    def d(self) -> int:
        """Number of coordinates."""
        return self.q.shape[1]

    @property
    def n_u(self) -> int:
        """Number of inputs."""
        return self.u.shape[1]

    @property
    def speed(self) -> Float64[np.ndarray, " d"]:
        """Root mean square of the velocities [1/s]."""
        return np.sqrt(np.mean(self.v**2, axis=0))


def sample_operating_region(record: Dataset, *, n: int | None = None, seed: int = 0) -> OperatingRegion:
    """About ``n`` points in the region of a record and `REGION_MARGIN` around it, by default `REGION_POINTS` and as many
    more for each coordinate.

    An input or a rate that never changes is varied by its own size, or by one, so that what it does can be
    told.
    """
    rng = np.random.default_rng(seed)
    half = max((REGION_POINTS * (1 + record.d) if n is None else n) // 2, 1)
    visited = np.linspace(0, len(record.q) - 1, min(half, len(record.q))).astype(int)
    drawn = rng.integers(len(record.q), size=(3, half))

    def around(x: np.ndarray, mixed: np.ndarray) -> np.ndarray:
        low, high = x.min(axis=0), x.max(axis=0)
        centre, reach = 0.5 * (low + high), 0.5 * (high - low)
        still = reach <= 1e-9 * np.maximum(np.abs(centre), 1e-9)
        own = np.where(still, np.where(np.abs(centre) > 0.0, np.abs(centre), 1.0), reach)
        near = x[mixed] + own * np.where(still, 1.0, REGION_MARGIN) * rng.uniform(
            -1.0, 1.0, (half, x.shape[1])
        )
        return np.concatenate([centre + (1.0 + REGION_MARGIN) * (x[visited] - centre), near])

    return OperatingRegion(around(record.q, drawn[0]), around(record.v, drawn[1]), around(record.u, drawn[2]))
