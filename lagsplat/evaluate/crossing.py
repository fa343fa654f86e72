"""The clip that crosses from training to held-out frames: where extrapolation is measured."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from lagsplat.chart.chart import Chart
from lagsplat.chart.clock import Clock
from lagsplat.evaluate.modes import fit_modes
from lagsplat.evaluate.resample import evenly_spaced
from lagsplat.io.split import crossing_frames


@dataclass(frozen=True)
class Crossing:
    """One clip as encoded, not smoothed: frames ``start`` to ``stop`` of the recording, held out from
    ``boundary`` on. ``period_s`` [s] is the natural period of its training part.
    """

    start: int
    boundary: int
    stop: int
    dt_s: float
    period_s: float
    latents: Float64[np.ndarray, "T d"]
    time_s: Float64[np.ndarray, " T"]
    metric: Float64[np.ndarray, "d d"]
    even: bool

    @property
    def n_train(self) -> int:
        """Training frames of the clip."""
        return self.boundary - self.start

    @property
    def ahead(self) -> Float64[np.ndarray, " held"]:
        """Instants of the held-out frames, in median spacings since the last training frame: 1, 2, ... on an
        even clock."""
        return self.places[self.n_train :] - self.places[self.n_train - 1]

    @property
    def places(self) -> Float64[np.ndarray, " T"]:
        """Instants of all frames, in median spacings since the first."""
        return (self.time_s - self.time_s[0]) / self.dt_s

    @property
    def clock(self) -> Clock:
        """The instants of the frames."""
        return Clock(self.dt_s, None if self.even else self.time_s)

    def history(self, periods: float) -> int:
        """Training frames in so many natural periods: at least four, at most all of them."""
        return int(np.clip(round(periods * self.period_s / self.dt_s), min(4, self.n_train), self.n_train))


def crossing_clip(chart: Chart) -> Crossing:
    """The clip of a chart that holds both training and held-out frames.

    Raises:
        ValueError: there is none, the mechanism is driven, or its training part shows no oscillation.
    """
    start, boundary, stop = crossing_frames(chart.segments, chart.n_train)
    if chart.inputs.shape[1] and np.ptp(chart.inputs[start:stop], axis=0).max() > 0:
        raise ValueError(
            "the clip is driven by inputs, and a forecaster of pictures knows none; take a free system"
        )
    latents, clock = chart.latents[start:stop], chart.whole.clock
    whole = chart.whole.part(start, stop)
    train = evenly_spaced(latents[: boundary - start], clock, start=start)
    modes = fit_modes(train, dt_s=chart.dt_s, metric=chart.metric, most=1)
    if not modes:
        raise ValueError("the training part of the clip shows no oscillation to take a natural period from")
    return Crossing(
        start=start,
        boundary=boundary,
        stop=stop,
        dt_s=chart.dt_s,
        period_s=1.0 / modes[0].frequency_hz,
        latents=latents,
        time_s=whole.time_s,
        metric=chart.metric,
        even=clock.time_s is None,
    )
