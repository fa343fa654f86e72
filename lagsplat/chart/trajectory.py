"""A latent trajectory: whitened states, the inputs that drove them and the instants they were filmed."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float64

from lagsplat.chart.clock import Clock, read_clock
from lagsplat.chart.smooth import smooth


@dataclass(frozen=True)
class Trajectory:
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
                raise ValueError(
                    f"segment ({start}, {stop}) does not lie within the {len(self.latents)} frames of the "
                    "trajectory; give half-open ranges of frames"
                )

    @cached_property
    def clock(self) -> Clock:
        """The instants of the frames, even or not."""
        return read_clock(self.time_s, self.segments)

    @property
    def dt_s(self) -> float:
        """Median time between two frames of one clip [s]."""
        return self.clock.dt_s

    def smoothed(self, sigma_frames: float) -> "Trajectory":
        """The same with latents and inputs smoothed by `smooth`, by their true times.

        Inputs keep their range: behind a step the filter would swing over, and a pressure becomes a suction.
        """
        latents, inputs = (
            smooth(series, sigma_frames=sigma_frames, segments=self.segments, clock=self.clock)
            for series in (self.latents, self.inputs)
        )
        if inputs.size:
            inputs = inputs.clip(self.inputs.min(axis=0), self.inputs.max(axis=0))
        return replace(self, latents=latents, inputs=inputs)

    def part(self, start: int, stop: int) -> "Trajectory":
        """Frames ``start`` to ``stop``, with the segments cut accordingly and counted from ``start``."""
        cut = ((max(a, start) - start, min(b, stop) - start) for a, b in self.segments)
        return Trajectory(
            latents=self.latents[start:stop],
            inputs=self.inputs[start:stop],
            time_s=self.time_s[start:stop],
            segments=tuple((a, b) for a, b in cut if a < b),
        )
