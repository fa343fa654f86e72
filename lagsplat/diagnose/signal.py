"""The inputs at every instant at which a rollout asks for them."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64

from lagsplat.diagnose.record import Record


@dataclass(frozen=True)
class Signal:
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


def stage_times(record: Record, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Instants (N, steps, 3) of a rollout's stages and the clip of each frame (N,)."""
    clip = np.zeros(len(record.time), dtype=np.int64)
    ahead = np.zeros(len(record.time))
    for number, (start, stop) in enumerate(record.clips):
        clip[start:stop] = number
        ahead[start : stop - 1] = np.diff(record.time[start:stop])
    share = (np.arange(steps)[:, None] + np.array([0.0, 0.5, 1.0])[None, :]) / steps
    return record.time[:, None, None] + ahead[:, None, None] * share, clip


def signals(record: Record, *, steps: int, held: bool) -> tuple[Signal, ...]:
    """The inputs of a record, one signal a channel."""
    time, clip = stage_times(record, steps)
    if held:  # the end of a substep is still under the input that was held during it, however late that acts
        time[:, :, 2] -= 1e-7
    per_frame = time.shape[1] * 3
    flat, clips = time.reshape(-1), np.repeat(clip, per_frame)
    begins = np.zeros(len(flat), dtype=bool)
    begins[record.clips[:, 0] * per_frame] = True
    out = []
    for column in record.u.T:
        logged = tuple((record.time[a:b], np.ascontiguousarray(column[a:b])) for a, b in record.clips)
        blank = Signal(flat, np.zeros(len(flat)), begins, clips, logged, held)
        out.append(replace(blank, values=blank.at(flat)))
    return tuple(out)
