"""Which stretch of a recording the rollout figure shows."""

from dataclasses import dataclass

from lagsplat.chart.chart import Chart
from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.protocol import HeldOut, held_out, series_of


@dataclass(frozen=True)
class Stretch:
    """Frames ``start`` to ``stop`` of ``series``, whose first frame is frame ``offset`` of the recording."""

    series: HeldOut
    offset: int
    start: int
    stop: int

    @property
    def frames(self) -> slice:
        """The stretch within the series."""
        return slice(self.start, self.stop)

    @property
    def last(self) -> int:
        """Its last frame, counted from the start of the recording."""
        return self.offset + self.stop - 1


def choose_stretch(chart: Chart, config: EvaluateConfig) -> Stretch:
    """The stretch that ``config.figure`` asks for, of at most its duration and within one clip.

    Raises:
        ValueError: ``boundary``, and no clip holds both training and held-out frames.

    Source: paper, the figures of the rainbow rocker (boundary) and of the hanging bag (held_out).
    """
    held = held_out(chart, config)
    most = round(config.figure.duration_s / chart.dt_s) + 1
    if config.figure.start == "held_out":
        start, stop = held.longest
        return Stretch(held, chart.n_train, start, min(start + most, stop))
    series = series_of(chart, chart.whole, config, skip=0)
    crossing = [clip for clip in series.clips if clip[0] < chart.n_train < clip[1]]
    if not crossing:
        raise ValueError(
            "evaluate.figure.start=boundary: the held-out part begins with a new clip, and no rollout can "
            "cross into it; use held_out"
        )
    begin, end = crossing[0]
    start = max(begin, end - most)
    if start > chart.n_train - most // 4:  # the held-out end would fill the figure
        start = max(begin, chart.n_train - most // 2)
    return Stretch(series, 0, start, min(start + most, end))


def held_from(stretch: Stretch, chart: Chart) -> int | None:
    """First held-out frame, counted from the start of the stretch; None if all of it is held out."""
    first = chart.n_train - stretch.offset - stretch.start
    return first if first > 0 else None
