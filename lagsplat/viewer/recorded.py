"""What the recording offers an interactive session: states to start from, and inputs to replay."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from lagsplat.chart.chart import Chart


@dataclass(frozen=True)
class Recorded:
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


def recorded_of(chart: Chart, *, names: tuple[str, ...], units: tuple[str, ...]) -> Recorded:
    """The whole recording, smoothed as the dynamics were fitted; velocities are central differences."""
    whole = chart.whole.smoothed(chart.smoothing_frames)
    v = np.zeros_like(whole.latents)
    for a, b in whole.segments:
        if b - a > 1:
            v[a:b] = np.gradient(whole.latents[a:b], whole.time_s[a:b], axis=0)
    return Recorded(whole.latents, v, whole.inputs, whole.segments, names, units)
