"""The mass matrix along a trajectory, as ellipses of equal kinetic energy."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure

from lagsplat.report.common.style import ENCODED, PAGE_IN, PREDICTED, QUIET, new_figure, paper_style

N_ELLIPSES = 24
ELLIPSE_SHARE = 0.07  # of the range of the trajectory: the median half axis
PANEL_IN = 1.75

Matrices = Float64[np.ndarray, "T d d"]
States = Float64[np.ndarray, "T d"]


def draw_inertia(forms: Sequence[tuple[str, Matrices]], states: States, *, title: str) -> Figure:
    """Draw a column for each form of the mass and a row for each two coordinates, in the order of the chart.

    An ellipse holds the velocities in the plane of the panel whose kinetic energy is at most one common
    value: wide where the inertia is small. Grey is the mean of the matrices, at the same places, so that what
    stands out of grey is the dependence on the state. With one coordinate the mass is drawn over it.

    Raises:
        ValueError: no form, or matrices of other states.
    """
    if not forms or any(len(matrices) != len(states) for _, matrices in forms):
        counts = {name: len(matrices) for name, matrices in forms}
        raise ValueError(f"inertia of {counts} states along a trajectory of {len(states)}")
    d = states.shape[1]
    planes = [(i, i + 1) for i in range(0, d - 1, 2)] + ([(d - 2, d - 1)] if d > 1 and d % 2 else [])
    rows = max(1, len(planes))
    with paper_style():
        width = min(PAGE_IN, PANEL_IN * len(forms) + 0.4)
        figure = new_figure(width, 0.45 + PANEL_IN * rows, title=title)
        axes = figure.subplots(rows, len(forms), sharex="row", sharey="row", squeeze=False)
        for column, (name, matrices) in enumerate(forms):
            axes[0, column].set_title(f"mass: {name}")
            if not planes:
                _draw_line(axes[0, column], states[:, 0], matrices[:, 0, 0])
            for row, plane in enumerate(planes):
                _draw_plane(axes[row, column], states[:, plane], matrices[:, plane][:, :, plane])
        for row, (i, j) in enumerate(planes):
            axes[row, 0].set_ylabel(f"$q_{{{j + 1}}}$")
            for axis in axes[row]:
                axis.set_xlabel(f"$q_{{{i + 1}}}$")
        if not planes:
            axes[0, 0].set_ylabel("$M$")
            for axis in axes[0]:
                axis.set_xlabel("$q_1$")
    return figure


def _draw_line(axis: Any, q: np.ndarray, mass: np.ndarray) -> None:
    order = np.argsort(q)
    axis.plot(q[order], mass[order], color=PREDICTED)
    axis.axhline(float(mass.mean()), color=QUIET, linestyle="--")
    axis.set_ylim(bottom=0.0)


def _draw_plane(axis: Any, states: np.ndarray, matrices: np.ndarray) -> None:
    axis.plot(*states.T, color=ENCODED, linewidth=0.3, alpha=0.12)
    chosen = _choose_distant(states, N_ELLIPSES)
    half = 1.0 / np.sqrt(np.linalg.eigvalsh(matrices))
    scale = ELLIPSE_SHARE * float(np.ptp(states, axis=0).max()) / float(np.median(half))
    mean = np.broadcast_to(matrices.mean(axis=0), matrices[chosen].shape)
    for shapes, colour, fill in ((mean, QUIET, 0.35), (matrices[chosen], PREDICTED, 0.0)):
        values, vectors = np.linalg.eigh(shapes)
        axes = 2.0 * scale / np.sqrt(values)
        angles = np.degrees(np.arctan2(vectors[:, 1, 0], vectors[:, 0, 0]))
        axis.add_collection(
            EllipseCollection(
                axes[:, 0],
                axes[:, 1],
                angles,
                units="xy",
                offsets=states[chosen],
                offset_transform=axis.transData,
                facecolors=(*_to_rgb(colour), fill),
                edgecolors="none" if fill else colour,
                linewidths=0.7,
            )
        )
    axis.margins(0.18)
    axis.set_aspect("equal", adjustable="box")


def _to_rgb(colour: str) -> tuple[float, ...]:
    return tuple(int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5))


def _choose_distant(states: np.ndarray, count: int) -> Int64[np.ndarray, " chosen"]:
    """Indices of states that are far from each other, the first one included (farthest-point sampling)."""
    chosen = [0]
    distance = np.linalg.norm(states - states[0], axis=1)
    while len(chosen) < min(count, len(states)):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(states - states[chosen[-1]], axis=1))
    return np.array(chosen)
