"""The data that a model is fitted to: trajectories joined clip by clip and cut into windows."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64, Int64

from lagsplat.diagnose.core.config import ESTIMATION
from lagsplat.diagnose.data_quality.noise import (
    LocalFit,
    fit_over_time,
    measure_noise,
    measure_residual_noise,
)
from lagsplat.io.trajectory.logged_inputs import LoggedInputs
from lagsplat.io.trajectory.trajectory import Trajectory

FILE_BREAK_S = 10.0  # pause [s] put between files whose clocks do not continue from one to the next
CUBIC_WIDTHS = ((0.004, 0.12), (0.015, 0.2), (np.inf, 0.28))
"""Width of the local cubic in natural periods, by the noise, relative to the rms, that it is used below."""
REGION_POINTS = 600  # points of an operating region, for no coordinate and again for each


@dataclass(frozen=True)
class Dataset:
    """``N`` frames of one or more files, joined along a common clock that starts with the first file."""

    time: Float64[np.ndarray, " N"]  # common clock [s]
    q: Float64[np.ndarray, "N d"]
    v: Float64[np.ndarray, "N d"]
    """Velocity estimates to start from [1/s]; see `lagsplat.diagnose.data_quality.noise.fit_over_time`."""
    u: Float64[np.ndarray, "N n_u"]
    clips: Int64[np.ndarray, "C 2"]  # first frame and end of each clip; there is a cut between clips
    files: tuple[str, ...]
    file_of: Int64[np.ndarray, " C"]  # number of the file of each clip
    shifts_s: tuple[float, ...]  # what each file's clock shows at zero of the common one [s]
    smooth: Float64[np.ndarray, "N d"]  # smoothed coordinates, as the velocities
    logs: tuple[LoggedInputs, ...] = ()
    """Inputs of each file at the rate of their log, by the common clock, where frames are means."""
    relative_noise: Float64[np.ndarray, " N"] | float = 1.0
    """Noise of each frame over that of all: means of many samples have less."""

    @classmethod
    def single_clip(cls, time: np.ndarray, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> "Dataset":
        """Frames without a cut that belong to no file."""
        return cls(time, q, v, u, np.array([[0, len(time)]]), ("",), np.zeros(1, dtype=np.int64), (0.0,), q)

    @property
    def d(self) -> int:
        """Number of coordinates."""
        return self.q.shape[1]

    @property
    def dt_s(self) -> float:
        """Median time between frames [s]."""
        return float(np.median(np.concatenate([np.diff(self.time[a:b]) for a, b in self.clips])))

    def to_file_time(self, time_s: float) -> tuple[int, float]:
        """Number of the file that an instant of the common clock falls into or after, and its clock [s]."""
        begun = self.time[self.clips[:, 0]] <= time_s
        number = int(self.file_of[np.flatnonzero(begun)[-1]]) if begun.any() else 0
        return number, time_s + self.shifts_s[number]


@dataclass(frozen=True)
class FileSpan:
    """A part of a file, from ``start_s`` to ``stop_s`` by the file's own clock [s]."""

    file: str
    start_s: float
    stop_s: float

    def overlaps(self, other: "FileSpan") -> bool:
        """Whether the two spans share more than an end point."""
        return self.file == other.file and self.start_s < other.stop_s and other.start_s < self.stop_s


@dataclass(frozen=True)
class WindowSet:
    """Windows of a dataset, each simulated from an initial state of its own."""

    first: Int64[np.ndarray, " W"]
    length: Int64[np.ndarray, " W"]

    @property
    def longest(self) -> int:
        """Frames of the longest window."""
        return int(self.length.max())

    def mask(self) -> Float64[np.ndarray, "W L"]:
        """One where a window has a frame, zero beyond its end."""
        return (np.arange(self.longest) < self.length[:, None]).astype(np.float64)

    def take(self, values: np.ndarray) -> np.ndarray:
        """Samples (W, L, ...) of the windows; beyond a window's end its last sample is repeated."""
        index = self.first[:, None] + np.minimum(np.arange(self.longest), self.length[:, None] - 1)
        return values[index]

    def initial_states(self, dataset: Dataset) -> Float64[np.ndarray, "W s"]:
        """States of the windows' first frames by smoothed coordinates and estimated velocities."""
        return np.concatenate([dataset.smooth, dataset.v], axis=1)[self.first]

    def select(self, chosen: np.ndarray) -> "WindowSet":
        """The windows that ``chosen``, a mask or an index, selects."""
        return WindowSet(self.first[chosen], self.length[chosen])

    def halve(self, min_frames: int) -> "WindowSet":
        """Both halves of every window, which share a frame; the whole of those too short for that."""
        cut = np.where(self.length >= 2 * min_frames, (self.length + 1) // 2, self.length)
        first = np.stack([self.first, self.first + cut - 1], axis=1)
        length = np.stack([cut, self.length - cut + 1], axis=1)
        return WindowSet(first[length > 1], length[length > 1])

    def subsample(self, frames: float) -> "WindowSet":
        """Evenly spaced windows with about ``frames`` frames in total; all windows if they have fewer."""
        return self.choose_evenly(max(round(len(self.first) * frames / float(self.length.sum())), 4))

    def choose_evenly(self, most: int) -> "WindowSet":
        """At most ``most`` windows, evenly spaced, the first and the last among them."""
        n = len(self.first)
        return self if most >= n else self.select(np.linspace(0, n - 1, most).astype(int))


def measure_window_noise(
    dataset: Dataset, windows: WindowSet, residual: Float64[np.ndarray, "W L d"], *, period_s: float
) -> Float64[np.ndarray, " d"]:
    """Noise in what a model leaves of windows, 0 where it is not known.

    Windows that it misses by more than they move are left out: there the residual is motion.
    """
    size = np.std(dataset.q, axis=0)
    parts = [
        (dataset.time[first : first + length], left[:length])
        for first, length, left in zip(windows.first, windows.length, residual, strict=True)
        if (np.mean(left[:length] ** 2, axis=0) < size**2).all()
    ]
    if not parts:
        return np.zeros(dataset.d)
    times_s, residuals = zip(*parts, strict=True)
    return measure_residual_noise(times_s, residuals, period_s=period_s)


def locate_windows(windows: WindowSet, dataset: Dataset) -> tuple[FileSpan, ...]:
    """Where the windows lie in the files of their dataset."""
    spans = []
    for first, length in zip(windows.first, windows.length, strict=True):
        number, start_s = dataset.to_file_time(float(dataset.time[first]))
        stop_s = float(dataset.time[first + length - 1]) + dataset.shifts_s[number]
        spans.append(FileSpan(dataset.files[number], start_s, stop_s))
    return tuple(spans)


def drop_overlapping_windows(windows: WindowSet, dataset: Dataset, others: Sequence[FileSpan]) -> WindowSet:
    """The windows that overlap none of ``others``."""
    overlapping = [any(span.overlaps(other) for other in others) for span in locate_windows(windows, dataset)]
    return windows.select(~np.array(overlapping, dtype=bool))


def join_trajectories(trajectories: Sequence[Trajectory], fits: Sequence[LocalFit]) -> Dataset:
    """One dataset of ``trajectories`` with their smoothed coordinates and velocity estimates."""
    clips, file_of, offset, shifts = [], [], 0, compute_clock_shifts(trajectories)
    times = []
    for number, (trajectory, shift) in enumerate(zip(trajectories, shifts, strict=True)):
        times.append(trajectory.time_s - shift)
        for start, stop in trajectory.segments:
            clips.append((offset + start, offset + stop))
            file_of.append(number)
        offset += trajectory.n
    logs = [
        replace(trajectory.input_log, time_s=trajectory.input_log.time_s - shift)
        for trajectory, shift in zip(trajectories, shifts, strict=True)
        if trajectory.input_log is not None
    ]
    return Dataset(
        time=np.concatenate(times),
        q=np.concatenate([m.q for m in trajectories]),
        v=np.concatenate([fit.v for fit in fits]),
        u=np.concatenate([m.u for m in trajectories]),
        clips=np.array(clips, dtype=np.int64),
        files=tuple(m.source for m in trajectories),
        file_of=np.array(file_of, dtype=np.int64),
        shifts_s=shifts,
        smooth=np.concatenate([fit.q for fit in fits]),
        logs=tuple(logs) if len(logs) == len(trajectories) else (),
        relative_noise=np.repeat(compare_noise(trajectories), [m.n for m in trajectories]),
    )


def compare_noise(trajectories: Sequence[Trajectory]) -> Float64[np.ndarray, " m"]:
    """Noise of the frames of each trajectory over that of all, if all were logged by one sensor."""
    averaged = np.array([1 if m.input_log is None else m.input_log.n for m in trajectories])
    variance = 1.0 / averaged
    return np.sqrt(variance / np.average(variance, weights=[m.n for m in trajectories]))


def compute_clock_shifts(trajectories: Sequence[Trajectory]) -> tuple[float, ...]:
    """What each file's clock shows [s] at zero of a common clock, which starts with the first file.

    Files whose clocks continue from one to the next keep their distances, unless a pause is longer than all
    recordings together; others follow each other after `FILE_BREAK_S`.
    """
    first, last = (np.array([m.time_s[i] for m in trajectories]) for i in (0, -1))
    pauses = first[1:] - last[:-1]
    if ((pauses > 0.0) & (pauses < (last - first).sum())).all():
        return (float(first[0]),) * len(trajectories)
    begins = np.append(0.0, np.cumsum(last - first + FILE_BREAK_S)[:-1])
    return tuple((first - begins).tolist())


def cut_windows(dataset: Dataset, *, length_s: float, min_frames: int) -> WindowSet:
    """Windows of about ``length_s`` [s], end to end, none across a cut and none below ``min_frames`` frames.

    Neighbours share their border frame.

    Raises:
        ValueError: no clip has ``min_frames`` frames.
    """
    first, length = [], []
    for start, stop in dataset.clips:
        if stop - start < min_frames:
            continue
        span_s = dataset.time[stop - 1] - dataset.time[start]
        most = (stop - start - 1) // max(min_frames - 1, 1)
        number = max(1, min(int(span_s / length_s + 0.5), most))
        borders = np.round(np.linspace(start, stop - 1, number + 1)).astype(int)
        first += borders[:-1].tolist()
        length += (np.diff(borders) + 1).tolist()
    if not first:
        raise ValueError(f"no clip has {min_frames} samples; record longer stretches without a cut")
    return WindowSet(np.array(first, dtype=np.int64), np.array(length, dtype=np.int64))


@dataclass(frozen=True)
class PreparedDataset:
    """A dataset with what was estimated from it."""

    dataset: Dataset
    acceleration: Float64[np.ndarray, "N d"]  # accelerations [1/s^2]
    sigma: Float64[np.ndarray, " d"]  # standard deviation of the measurement noise


def prepare_dataset(trajectories: Sequence[Trajectory], *, period_s: float) -> PreparedDataset:
    """Join trajectories, measure their noise, and estimate velocities and accelerations by local cubics.

    ``period_s`` is the natural period [s]. Velocities come from a wider cubic where the noise is stronger
    (`CUBIC_WIDTHS`).
    """
    rms = np.std(np.concatenate([m.q for m in trajectories]), axis=0)
    alike = [
        replace(m, q=m.q / relative, resolution=tuple(np.array(m.resolution) / relative))
        for m, relative in zip(trajectories, compare_noise(trajectories), strict=True)
    ]
    sigma = np.maximum(
        measure_noise(alike, period_s=period_s).known_sigma, ESTIMATION.min_relative_noise * rms
    )
    worst = float(np.max(sigma / np.maximum(rms, 1e-300)))
    width_s = next((share for limit, share in CUBIC_WIDTHS if worst < limit), CUBIC_WIDTHS[-1][1]) * period_s
    fits = [fit_over_time(motion, width_s=width_s) for motion in trajectories]
    acceleration = np.concatenate([fit.a for fit in fits])
    return PreparedDataset(join_trajectories(trajectories, fits), acceleration, sigma)


@dataclass(frozen=True)
class OperatingRegion:
    """States and inputs, one a row: visited ones, and as many that combine values from different frames."""

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

    def select(self, chosen: np.ndarray) -> "OperatingRegion":
        """The rows that ``chosen``, a mask or an index, selects."""
        return OperatingRegion(self.q[chosen], self.v[chosen], self.u[chosen])

    @property
    def speed(self) -> Float64[np.ndarray, " d"]:
        """Root mean square of the velocities [1/s]."""
        return np.sqrt(np.mean(self.v**2, axis=0))


def sample_operating_region(dataset: Dataset, *, seed: int = 0) -> OperatingRegion:
    """States and inputs in the region of a dataset and `ESTIMATION.region_margin` around it.

    They are `REGION_POINTS` and as many more for each coordinate. An input or a rate that never
    changes is varied by its own size, or by 1, so that its influence can be measured.
    """
    rng = np.random.default_rng(seed)
    half = REGION_POINTS * (1 + dataset.d) // 2
    visited = np.linspace(0, len(dataset.q) - 1, min(half, len(dataset.q))).astype(int)
    drawn = rng.integers(len(dataset.q), size=(3, half))

    def around(x: np.ndarray, mixed: np.ndarray) -> np.ndarray:
        low, high = x.min(axis=0), x.max(axis=0)
        centre, reach = 0.5 * (low + high), 0.5 * (high - low)
        still = reach <= 1e-9 * np.maximum(np.abs(centre), 1e-9)
        spread = np.where(still, np.where(np.abs(centre) > 0.0, np.abs(centre), 1.0), reach)
        share = np.where(still, 1.0, ESTIMATION.region_margin)
        near = x[mixed] + spread * share * rng.uniform(-1.0, 1.0, (half, x.shape[1]))
        return np.concatenate([centre + (1.0 + ESTIMATION.region_margin) * (x[visited] - centre), near])

    q, v, u = (around(x, mixed) for x, mixed in zip((dataset.q, dataset.v, dataset.u), drawn, strict=True))
    return OperatingRegion(q, v, u)
