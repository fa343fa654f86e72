"""Latent trajectories: whitened states with inputs and times, their time base, and smoothing within clips."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import prod

import numpy as np
from jaxtyping import Float64, Int
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from lagsplat.array_types import Series

Segments = Sequence[tuple[int, int]]  # half-open clips of frames


@dataclass(frozen=True)
class TimeBase:
    """Frames ``dt_s`` [s] apart, or at the instants ``time_s`` where that is not None.

    On an even clock every time is an exact multiple of ``dt_s``, and steps are plain numbers.
    """

    dt_s: float
    time_s: Float64[np.ndarray, " T"] | None = None

    def elapsed_s(self, at: Int[np.ndarray, " B"], ahead: int) -> float | Float64[np.ndarray, "B 1"]:
        """Time [s] from each frame to the one ``ahead`` of it; negative ``ahead`` counts back."""
        if self.time_s is None:
            return ahead * self.dt_s
        return (self.time_s[at + ahead] - self.time_s[at])[:, None]

    def steps_s(self, at: Int[np.ndarray, " B"], n_states: int) -> float | Float64[np.ndarray, "B n"]:
        """Times [s] between the ``n_states`` frames that begin at each frame, one fewer than these."""
        if self.time_s is None:
            return self.dt_s
        return np.diff(self.time_s[at[:, None] + np.arange(n_states)], axis=1)

    def instants_s(self, start: int, n_states: int) -> Float64[np.ndarray, " N"]:
        """Times [s] of ``n_states`` frames since the first of them, ``start``."""
        if self.time_s is None:
            return self.dt_s * np.arange(n_states)
        return self.time_s[start : start + n_states] - self.time_s[start]

    def slope(
        self, series: Series, at: Int[np.ndarray, " B"], stencil: Sequence[int]
    ) -> Float64[np.ndarray, "B m"]:
        """Slope [1/s] at frames of the polynomial through them and the frames ``stencil`` away from each.

        The polynomial's order is the length of the stencil: ``(1, 2)`` and ``(-1, 1)`` are of second order
        and ``(-2, -1, 1, 2)`` is of fourth, on true times; on an even clock, textbook differences.
        """
        away = {ahead: self.elapsed_s(at, ahead) for ahead in stencil}
        slope = np.zeros((len(at), series.shape[1]))
        for ahead, x in away.items():
            others = [y for other, y in away.items() if other != ahead]
            weight = prod(y / (y - x) for y in others) / x
            slope += weight * (series[at + ahead] - series[at])
        return slope


@dataclass(frozen=True)
class EncodedTrajectory:
    """Whitened latents with their inputs and times; ``segments`` are half-open clips that do not touch.

    Raises:
        ValueError: a segment lies outside the trajectory.
    """

    latents: Float64[np.ndarray, "T d"]
    inputs: Float64[np.ndarray, "T n_u"]
    time_s: Float64[np.ndarray, " T"]
    segments: tuple[tuple[int, int], ...]

    def __post_init__(self) -> None:
        for start, stop in self.segments:
            if not 0 <= start < stop <= len(self.latents):
                frames = f"the {len(self.latents)} frames of the trajectory"
                raise ValueError(f"segment ({start}, {stop}) is no half-open range within {frames}")

    @cached_property
    def clock(self) -> TimeBase:
        """The time base of the frames, even or not."""
        return read_time_base(self.time_s, self.segments)

    @property
    def dt_s(self) -> float:
        """Median time between two frames of one clip [s]."""
        return self.clock.dt_s

    def smoothed(self, sigma_frames: float) -> "EncodedTrajectory":
        """The trajectory with latents and inputs smoothed by `smooth_trajectory`, on true times.

        Inputs keep their range: otherwise the filter turns a pressure step into suction.
        """
        latents = smooth_trajectory(self.latents, sigma_frames, self.segments, self.clock)
        inputs = smooth_trajectory(self.inputs, sigma_frames, self.segments, self.clock)
        if inputs.size:
            inputs = inputs.clip(self.inputs.min(axis=0), self.inputs.max(axis=0))
        return replace(self, latents=latents, inputs=inputs)

    def differentiate(self, order: int) -> Float64[np.ndarray, "T d"]:
        """Derivatives of the latents [1/s^order] of cubic splines through each segment; zero outside."""
        slopes = np.zeros_like(self.latents)
        for start, stop in self.segments:
            if stop - start > 1:
                spline = CubicSpline(self.time_s[start:stop], self.latents[start:stop])
                slopes[start:stop] = spline(self.time_s[start:stop], order)
        return slopes

    def part(self, start: int, stop: int) -> "EncodedTrajectory":
        """Frames ``start`` to ``stop``, with the segments cut accordingly and counted from ``start``."""
        cut = ((max(a, start) - start, min(b, stop) - start) for a, b in self.segments)
        segments, kept = tuple((a, b) for a, b in cut if a < b), slice(start, stop)
        return EncodedTrajectory(self.latents[kept], self.inputs[kept], self.time_s[kept], segments)


EVEN = 1e-4  # deviation from the median spacing up to which a clock is even: bounds the error of a frequency
TRUNCATE = 4.0  # reach of the smoothing kernel, in its sigmas


def read_time_base(time_s: Float64[np.ndarray, " T"], segments: Segments) -> TimeBase:
    """The time base of frames at ``time_s`` [s]; times between two clips do not count.

    Raises:
        ValueError: no two frames are in one clip.
    """
    steps = np.concatenate([np.diff(time_s[a:b]) for a, b in segments] or [np.zeros(0)])
    if steps.size == 0:
        raise ValueError(f"no two of {len(time_s)} frame(s) share a clip; give longer clips or another split")
    dt_s = float(np.median(steps))
    even = float(np.abs(steps - dt_s).max()) <= EVEN * dt_s
    return TimeBase(dt_s, None if even else time_s)


def smooth_trajectory(series: Series, sigma_frames: float, segments: Segments, clock: TimeBase) -> Series:
    """Smooth each column by a Gaussian of ``sigma_frames``, and add the smoothed residual back (twicing).

    A Gaussian alone shrinks an oscillation of 20 sigma a period by 5 %, and so biases how the learned
    frequency depends on amplitude; twicing shrinks it by 0.2 %. The kernel is cut at 4 sigma and each
    segment is smoothed alone, continued beyond its ends by point reflection, so that a steady motion stays
    steady. The filter is not causal. Samples outside every segment are unchanged. On an uneven clock the
    value is that of a line fitted with weights at the true times. A sigma of 0 returns a copy.

    Source: twicing, Tukey 1977, "Exploratory Data Analysis", section 16.
    """
    if sigma_frames == 0.0 or series.shape[1] == 0:
        return series.copy()
    once = _blur(series, sigma_frames, segments, clock)
    return once + _blur(series - once, sigma_frames, segments, clock)


def _blur(series: Series, sigma_frames: float, segments: Segments, clock: TimeBase) -> Series:
    smoothed = series.copy()
    for start, stop in segments:
        part = slice(start, stop)
        if clock.time_s is None:
            reach = int(TRUNCATE * sigma_frames + 0.5)
            longer = _beyond(series[part], reach)
            blurred = gaussian_filter1d(longer, sigma_frames, axis=0, truncate=TRUNCATE)
            smoothed[part] = blurred[reach : len(longer) - reach]
        else:
            smoothed[part] = _local_lines(series[part], clock.time_s[part] / clock.dt_s, sigma_frames)
    return smoothed


def _local_lines(series: Series, time: np.ndarray, sigma: float) -> Series:
    """Values at ``time`` (in median spacings) of lines fitted around each sample with Gaussian weights."""
    reach = int(TRUNCATE * sigma + 0.5)
    time = _beyond(time[:, None], reach)[:, 0]
    padded = _beyond(series, reach)
    taps = np.arange(len(series))[:, None] + np.arange(2 * reach + 1)
    x = time[taps] - time[reach : len(time) - reach, None]
    weight = np.exp(-0.5 * (x / sigma) ** 2)
    # A weighted mean belongs to the mean of its times, which on an uneven clock is not the frame's time;
    # the jitter of the clock would become jitter of the state. A local line removes that. Weights by frame
    # number would have the same fault, and a kernel width that changes with the clock besides.
    zeroth, first, second = (np.sum(weight * x**power, axis=1, keepdims=True) for power in range(3))
    spread = zeroth * second - first**2
    lone = spread <= 1e-12 * zeroth**2
    share = np.where(lone, x == 0.0, weight * (second - first * x) / np.where(lone, 1.0, spread))
    return np.einsum("tk,tkm->tm", share, padded[taps])


def _beyond(series: np.ndarray, reach: int) -> np.ndarray:
    """``series`` with ``reach`` more samples at either end, by point reflection."""
    if len(series) == 1:
        return np.repeat(series, 2 * reach + 1, axis=0)
    return np.pad(series, ((reach, reach), (0, 0)), mode="reflect", reflect_type="odd")
