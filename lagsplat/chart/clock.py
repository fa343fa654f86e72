"""The instants of the frames, even or not, and what is measured by them: steps and velocities."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import prod

import numpy as np
from jaxtyping import Float64, Int

from lagsplat.shapes import Series

EVEN = 1e-4
"""Deviation from the median spacing, relative to it, up to which a clock counts as even: a frequency is then
off by no more than that."""


@dataclass(frozen=True)
class Clock:
    """Frames ``dt_s`` [s] apart, or at the instants ``time_s`` where that is not None.

    On an even clock every result is the one of exact multiples of ``dt_s``, and steps are plain numbers.
    """

    dt_s: float
    time_s: Float64[np.ndarray, " T"] | None = None

    def elapsed_s(self, at: Int[np.ndarray, " B"], ahead: int) -> float | Float64[np.ndarray, "B 1"]:
        """Time [s] from each frame to the one ``ahead`` of it; negative ``ahead`` looks back."""
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

        Its order is the length of the stencil: ``(1, 2)`` and ``(-1, 1)`` are of second order and
        ``(-2, -1, 1, 2)`` is of fourth, on true times; on an even clock they are the textbook differences.
        """
        away = {ahead: self.elapsed_s(at, ahead) for ahead in stencil}
        slope = np.zeros((len(at), series.shape[1]))
        for ahead, x in away.items():
            others = [y for other, y in away.items() if other != ahead]
            weight = prod(y / (y - x) for y in others) / x
            slope += weight * (series[at + ahead] - series[at])
        return slope


def read_clock(time_s: Float64[np.ndarray, " T"], segments: Sequence[tuple[int, int]]) -> Clock:
    """The clock of frames at ``time_s`` [s]; times between two clips do not count.

    Raises:
        ValueError: no two frames are in one clip.
    """
    steps = np.concatenate([np.diff(time_s[a:b]) for a, b in segments] or [np.zeros(0)])
    if steps.size == 0:
        raise ValueError(
            f"{len(time_s)} frame(s) and no two of them in one clip: they have no spacing in time; give "
            "longer clips or another split"
        )
    dt_s = float(np.median(steps))
    even = float(np.abs(steps - dt_s).max()) <= EVEN * dt_s
    return Clock(dt_s, None if even else time_s)
