"""Inputs of a dataset as rollouts take them, and as effects change them on their way."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float64

from lagsplat.diagnose.core.config import ESTIMATION
from lagsplat.diagnose.estimation.dataset import Dataset

HELD_UNTIL_S = 1e-7  # before the next sample, at which an input that is held is read last [s]


@dataclass(frozen=True)
class InputSignal:
    """A single input at instants in the order of time: at the start, middle and end of every substep of every
    frame or, where frames are means, at the samples of the log."""

    time: Float64[np.ndarray, " M"]
    begins: Bool[np.ndarray, " M"]  # where a clip begins
    clip: np.ndarray  # number of the clip of each instant (M,)
    logged: tuple[tuple[np.ndarray, np.ndarray], ...]  # times and values of the log, clip by clip
    held: bool  # held between samples of the log (zero-order hold) instead of linear
    to_stages: Callable[[np.ndarray], np.ndarray] = field(default=lambda values: values)
    """From values (P, M) to those at the stages (P, K) of a rollout."""

    def with_values(self, values: Float64[np.ndarray, " M"]) -> "InputSignal":
        """The signal of an input that was changed on its way."""
        # a substep ends where the next one begins
        distinct = np.append(True, np.diff(self.time) > 0.0) | self.begins
        clips = [distinct & (self.clip == number) for number in range(len(self.logged))]
        return replace(self, logged=tuple((self.time[inside], values[inside]) for inside in clips))

    @cached_property
    def values(self) -> Float64[np.ndarray, " M"]:
        """The logged input at ``time``."""
        return self.at(self.time)

    def at(self, time: Float64[np.ndarray, " M"]) -> Float64[np.ndarray, " M"]:
        """The logged input at other instants [s]; outside a clip its nearest sample."""
        out = np.empty(len(time))
        for number, (logged_s, values) in enumerate(self.logged):
            inside = self.clip == number
            if self.held:  # an instant that rounding put a nanosecond early still has the new value
                index = np.searchsorted(logged_s, time[inside] + 1e-9, side="right") - 1
                out[inside] = values[np.clip(index, 0, len(values) - 1)]
            else:
                out[inside] = interpolate_input(time[inside], logged_s, values)
        return out


def interpolate_input(
    time_s: Float64[np.ndarray, " M"], logged_s: Float64[np.ndarray, " N"], values: Float64[np.ndarray, " N"]
) -> Float64[np.ndarray, " M"]:
    """An input at instants ``time_s``: linear between samples, and a parabola where samples are missing.

    A straight line across a missing sample cuts off the bend there, which pushes the mechanism. The bend is
    the mean of those before and after, at most twice the smaller one, and none where these differ in sign, as
    at a step.

    Source: the monotonised central limiter, van Leer 1977, doi:10.1016/0021-9991(77)90095-X.
    """
    out = np.interp(time_s, logged_s, values)
    if len(logged_s) < 4:  # no bend before and after
        return out
    steps = np.diff(logged_s)
    wide = np.append(steps > ESTIMATION.missing_steps * np.median(steps), False)
    at = np.searchsorted(logged_s, time_s, side="right") - 1
    missing = np.flatnonzero(wide[at])
    if len(missing):
        bends = 2.0 * np.diff(np.diff(values) / steps) / (steps[1:] + steps[:-1])
        before, after = np.append(0.0, bends), np.append(bends, 0.0)
        size = np.minimum(0.5 * abs(before + after), 2.0 * np.minimum(abs(before), abs(after)))
        bend = np.where(before * after > 0.0, np.sign(before) * size, 0.0)
        i, t = at[missing], time_s[missing]
        out[missing] += 0.5 * bend[i] * (t - logged_s[i]) * (t - logged_s[i + 1])
    return out


def compute_stage_times(dataset: Dataset, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Instants (N, steps, 3) [s] of a rollout's stages and the number of the clip of each frame (N,)."""
    clip = np.zeros(len(dataset.time), dtype=np.int64)
    ahead = np.zeros(len(dataset.time))
    for number, (start, stop) in enumerate(dataset.clips):
        clip[start:stop] = number
        ahead[start : stop - 1] = np.diff(dataset.time[start:stop])
    return dataset.time[:, None, None] + ahead[:, None, None] * _list_stages(steps), clip


def _list_stages(steps: int) -> Float64[np.ndarray, "S 3"]:
    """Start, middle and end of every substep, as shares of the time to the next frame."""
    return (np.arange(steps)[:, None] + np.array([0.0, 0.5, 1.0])) / steps


def build_input_signals(dataset: Dataset, *, steps: int, held: bool) -> tuple[InputSignal, ...]:
    """The inputs of a dataset, one signal a channel, for ``steps`` substeps between two frames."""
    if dataset.logs and all(log.held == held for log in dataset.logs):
        return _build_fine_signals(dataset, steps=steps)
    time, clip = compute_stage_times(dataset, steps)
    if held:  # the end of a substep, read 0.1 us early, still has the input that was held during it
        time[:, :, 2] -= HELD_UNTIL_S
    per_frame = time.shape[1] * 3
    flat, clips = time.reshape(-1), np.repeat(clip, per_frame)
    begins = np.zeros(len(flat), dtype=bool)
    begins[dataset.clips[:, 0] * per_frame] = True
    inputs = []
    for column in dataset.u.T:
        logged = tuple((dataset.time[a:b], np.ascontiguousarray(column[a:b])) for a, b in dataset.clips)
        inputs.append(InputSignal(flat, begins, clips, logged, held))
    return tuple(inputs)


def _build_fine_signals(dataset: Dataset, *, steps: int) -> tuple[InputSignal, ...]:
    """Signals at the samples of the log; of held inputs, at the beginning and the end of each hold."""
    logs, held = dataset.logs, dataset.logs[0].held
    parts = [(log, slice(a, b)) for log in logs for a, b in log.segments]
    times = [log.time_s[part] for log, part in parts]
    each = 2 if held else 1
    instants = [
        np.stack([time, np.append(time[1:], time[-1]) - HELD_UNTIL_S], axis=1).ravel() if held else time
        for time in times
    ]
    lengths = [len(part) for part in instants]
    begins = np.zeros(sum(lengths), dtype=bool)
    begins[np.cumsum([0, *lengths[:-1]])] = True
    of_file = np.cumsum([0, *(each * len(log.time_s) for log in logs)])
    left = np.repeat(np.arange(len(dataset.time)), 3 * steps)
    share = np.tile(_list_stages(steps).ravel(), len(dataset.time))
    share[held | np.isin(left, dataset.clips[:, 1] - 1)] = 0.0

    def to_stages(values: np.ndarray) -> np.ndarray:
        means = [
            log.average(values[:, a:b].reshape(len(values), -1, each).mean(axis=2).T)
            for log, a, b in zip(logs, of_file, of_file[1:], strict=False)
        ]
        frames = np.concatenate(means).T
        return frames[:, left] * (1.0 - share) + frames[:, np.minimum(left + 1, frames.shape[1] - 1)] * share

    time, clip = np.concatenate(instants), np.repeat(np.arange(len(parts)), lengths)
    return tuple(
        InputSignal(
            time,
            begins,
            clip,
            tuple((at, log.u[part, channel]) for at, (log, part) in zip(times, parts, strict=True)),
            held,
            to_stages,
        )
        for channel in range(dataset.u.shape[1])
    )
