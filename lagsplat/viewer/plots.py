"""Live plots beside the picture: the state, the energy, and what the books of energy cannot explain."""

from collections import deque

import numpy as np
import viser
from viser import uplot

from lagsplat.viewer.session import Snapshot

COLORS = ("#4c9be8", "#e8743b", "#3fb68b", "#c678dd", "#e5c07b", "#9aa0a6")
HEIGHT = 150
POINTS = 300


class Plots:
    """Three charts of the last ``span_s`` seconds of model time; `add` collects, `show` sends."""

    def __init__(self, gui: viser.GuiApi, *, d: int, span_s: float) -> None:
        self.span_s = span_s
        self.rows: deque[list[float]] = deque(maxlen=POINTS)
        self.state = _chart(gui, "State q (whitened)", [f"q{i}" for i in range(d)])
        self.energy = _chart(gui, "Energy (law's unit)", ["kinetic", "potential", "total"])
        self.books = _chart(gui, "Energy balance", ["hand", "inputs", "dissipated", "unexplained"])
        self.d = d

    def add(self, snapshot: Snapshot) -> None:
        """Take a snapshot in, unless one of nearly the same instant is in; a leap back begins anew."""
        if self.rows and snapshot.time_s < self.rows[-1][0]:
            self.rows.clear()
        if self.rows and snapshot.time_s < self.rows[-1][0] + self.span_s / POINTS:
            return
        energy = snapshot.energy
        self.rows.append(
            [
                snapshot.time_s, *snapshot.q.tolist(),
                energy.kinetic, energy.potential, energy.total,
                energy.hand, energy.inputs, energy.dissipated, energy.error,
            ]
        )  # fmt: skip

        while self.rows[0][0] < snapshot.time_s - self.span_s:
            self.rows.popleft()

    def show(self) -> None:
        """Send what is collected."""
        if len(self.rows) < 2:
            return
        table = np.array(self.rows)
        time_s, columns = table[:, 0], table[:, 1:].T
        d = self.d
        for chart, part in (
            (self.state, columns[:d]),
            (self.energy, columns[d : d + 3]),
            (self.books, columns[d + 3 :]),
        ):
            chart.data = (time_s, *(np.ascontiguousarray(row) for row in part))


def _chart(gui: viser.GuiApi, title: str, names: list[str]) -> viser.GuiUplotHandle:
    series = (
        uplot.Series(label="t [s]"),
        *(
            uplot.Series(label=name, stroke=COLORS[i % len(COLORS)], width=1.6)
            for i, name in enumerate(names)
        ),
    )
    empty = np.zeros(2)
    axes = (uplot.Axis(size=28, stroke="#8a8f98"), uplot.Axis(size=46, stroke="#8a8f98"))
    return gui.add_uplot(
        (np.array([0.0, 1.0]), *(empty for _ in names)),
        series,
        title=title,
        height=HEIGHT,
        scales={"x": uplot.Scale(time=False)},
        axes=axes,
        legend=uplot.Legend(show=True),
    )
