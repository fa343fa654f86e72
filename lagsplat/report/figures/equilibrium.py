"""Figures of a fitted law: where long rollouts end, and the mass matrix along a trajectory."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

from lagsplat.report.common import style

COLOURS = (style.INPUTS[3], style.INPUTS[1])
MIN_SHARE = 1e-5  # share of the amplitude below which a motion is drawn at the edge
RUN_TITLE = "LaGSplat"
N_ELLIPSES = 24
ELLIPSE_SHARE = 0.07  # of the range of the trajectory: the median half axis
PANEL_IN = 1.75

Extrapolation = Mapping[str, Any]
Matrices = Float64[np.ndarray, "T d d"]
States = Float64[np.ndarray, "T d"]


def draw_equilibrium(
    run: Extrapolation, models: Mapping[str, Sequence[Extrapolation]], *, title: str
) -> Figure:
    """Draw the trajectories of a run and of other models, their end states, and the amplitude that is left.

    ``run`` and ``models`` are results of the extrapolation of one clip; the first seed of each model is drawn
    in full, the others as faint lines. Where there are several coordinates, the one that moves most is drawn.

    Source: paper, the figure of free extrapolation far past the clip.
    """
    results = {RUN_TITLE: [run], **{name: seeds for name, seeds in models.items() if seeds}}
    colours = dict(zip(results, (style.PREDICTED, *COLOURS), strict=False))
    with style.paper_style():
        figure = style.new_figure(style.PAGE_IN, 1.15 * len(results) + 0.5, title=title)
        left, right = np.asarray(figure.subfigures(1, 2, width_ratios=(1.75, 1.0)))
        axes = np.atleast_1d(left.subplots(len(results), 1, sharex=True, sharey=True))
        for axis, (name, seeds) in zip(axes, results.items(), strict=True):
            _draw_trajectory(axis, run, seeds, name, colours[name])
        axes[-1].set_xlabel("time since the start of the clip (s)")
        axes[len(axes) // 2].set_ylabel("state in the chart of the frozen encoder")
        phase, decay = right.subplots(2, 1)
        _draw_phase_plane(phase, run, results, colours)
        _draw_decay(decay, results, colours)
    return figure


def _coordinate(states: Any) -> np.ndarray:
    """The series of the coordinate that moves most."""
    series = np.asarray(states, dtype=np.float64)
    return series[:, _find_widest(series)]


def _find_widest(series: States) -> int:
    return int(np.argmax(np.nanstd(series, axis=0)))


def _find_middle(run: Extrapolation) -> float:
    """The equilibrium in the coordinate of the clip that moves most, or the mean of the clip without one."""
    series, rest = np.asarray(run["clip"], dtype=np.float64), run["equilibrium"]
    return float((series.mean(axis=0) if rest is None else rest)[_find_widest(series)])


def _draw_trajectory(
    axis: Axes, run: Extrapolation, seeds: Sequence[Extrapolation], name: str, colour: str
) -> None:
    dt_s, frames = run["recording"]["dt_s"], run["recording"]["frames"]
    last_train = frames - run["recording"]["held_out"] - 1
    clip, middle = _coordinate(run["clip"]), _find_middle(run)
    axis.axvspan(0, (frames - 1) * dt_s, color=style.QUIET, alpha=0.18, linewidth=0)
    if run["equilibrium"] is not None:
        axis.axhline(middle, color=style.MARK, linestyle="--", linewidth=0.6)
    for index, result in reversed(list(enumerate(seeds))):
        path = _coordinate(result["looks"][0]["states"])
        time_s = (last_train + np.arange(len(path))) * dt_s
        alpha, width = (0.25, 0.4) if index else (1.0, 0.7)
        axis.plot(time_s, path, color=colour, alpha=alpha, linewidth=width)
    axis.plot(np.arange(frames) * dt_s, clip, color=style.ENCODED, linewidth=0.6)
    text = f"{name}: outside the range of the encoder" if seeds[0]["reason"] else name
    axis.set_title(text, loc="left", color=colour, pad=2)
    ends = np.ptp(clip) * 0.62
    axis.set_ylim(middle - ends, middle + ends)
    if name == RUN_TITLE:
        top = (0.5 * frames * dt_s, middle + 0.93 * ends)
        axis.annotate("the clip", top, ha="center", va="top", color=style.ENCODED)
        said = "no equilibrium" if run["equilibrium"] is None else "dashed: minimum of V"
        last = (last_train + len(seeds[0]["looks"][0]["states"])) * dt_s
        corner = (last, middle + 0.93 * ends)
        axis.annotate(said, corner, ha="right", va="top", color=style.MARK_WORDS)


def _draw_phase_plane(
    axis: Axes, run: Extrapolation, results: Mapping[str, Sequence[Extrapolation]], colours: Any
) -> None:
    """Draw the last seconds of the drawn part, long after the end of the clip."""
    dt_s, middle = run["recording"]["dt_s"], _find_middle(run)
    clip = _coordinate(run["clip"])
    axis.plot(clip, np.gradient(clip, dt_s), color=style.ENCODED, alpha=0.25, linewidth=0.5)
    for name, seeds in results.items():
        if seeds[0]["reason"]:
            continue
        path = _coordinate(seeds[0]["looks"][0]["states"])
        late = path[-max(len(path) // 8, 8) :]
        if name == RUN_TITLE:
            axis.plot(path, np.gradient(path, dt_s), color=colours[name], linewidth=0.4, alpha=0.6)
            axis.plot(late[-1], 0.0, "o", color=colours[name], markersize=4, zorder=5)
        else:
            axis.plot(late, np.gradient(late, dt_s), color=colours[name], linewidth=0.7)
    axis.set_title("state and velocity in the end", loc="left", pad=2)
    reach, speed = np.abs(clip - middle).max(), np.abs(np.gradient(clip, dt_s)).max()
    axis.set(xlabel="state", ylabel="velocity (1/s)")
    axis.set(xlim=(middle - 1.25 * reach, middle + 1.25 * reach), ylim=(-1.25 * speed, 1.25 * speed))


def _draw_decay(axis: Axes, results: Mapping[str, Sequence[Extrapolation]], colours: Any) -> None:
    for name, seeds in results.items():
        # the run is dashed, over whatever falls on the same line
        dashes, order = ("--", 3) if name == RUN_TITLE else ("-", 2)
        for index, result in enumerate(seeds):
            if result["reason"]:
                continue
            time_s, share = _measure_envelope(result)
            alpha, width = (0.3, 0.5) if index else (1.0, 1.0)
            look = {"color": colours[name], "alpha": alpha}
            label = None if index else name
            axis.plot(time_s, share, dashes, label=label, linewidth=width, zorder=order, **look)
            later = len(result["looks"]) - 1
            axis.plot(time_s[-later:], share[-later:], "o", markersize=2, **look)
    axis.set(xscale="log", yscale="log", xlabel="time past the training frames (s)")
    axis.set_ylim(MIN_SHARE / 1.5, 3.0)
    axis.set_title("amplitude left, as a share of the clip's first", loc="left", pad=2)
    axis.legend(loc="lower left", handlelength=0.0, handletextpad=0.0, labelcolor="linecolor")


def _measure_envelope(result: Extrapolation) -> tuple[np.ndarray, np.ndarray]:
    """Amplitudes over the clip's first: along the drawn part, two periods at a time, then of each look."""
    dt_s, start = result["recording"]["dt_s"], result["start_amplitude"]
    first, *later = result["looks"]
    path, width = _coordinate(first["states"]), max(round(2 * result["recording"]["period_s"] / dt_s), 4)
    cuts = range(0, len(path) - width + 1, width)
    points = [((cut + width / 2) * dt_s, float(np.ptp(path[cut : cut + width])) / 2) for cut in cuts]
    points += [(look["time_s"] + len(look["states"]) * dt_s, look["amplitude"]) for look in later]
    time_s, left = np.array(points).T
    return time_s, np.clip(np.nan_to_num(left / start, nan=10.0, posinf=10.0), MIN_SHARE, 10.0)


def draw_inertia(forms: Sequence[tuple[str, Matrices]], states: States, *, title: str) -> Figure:
    """Draw a column for each form of the mass and a row for each two coordinates, named as in the chart.

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
    with style.paper_style():
        width = min(style.PAGE_IN, PANEL_IN * len(forms) + 0.4)
        figure = style.new_figure(
            width, 0.75 + PANEL_IN * rows, title=f"{title}\n{_describe_inertia(d, len(states))}"
        )
        axes = figure.subplots(rows, len(forms), sharex="row", sharey="row", squeeze=False)
        for column, (name, matrices) in enumerate(forms):
            axes[0, column].set_title(f"mass: {name}")
            if not planes:
                axis, order, mass = axes[0, column], np.argsort(states[:, 0]), matrices[:, 0, 0]
                axis.plot(states[order, 0], mass[order], color=style.PREDICTED)
                axis.axhline(float(mass.mean()), color=style.QUIET, linestyle="--")
                axis.set_ylim(bottom=0.0)
            for row, plane in enumerate(planes):
                _draw_plane(axes[row, column], states[:, plane], matrices[:, plane][:, :, plane])
        labels = [(f"$q_{{{i + 1}}}$", f"$q_{{{j + 1}}}$") for i, j in planes] or [("$q_1$", "mass")]
        for row, (xlabel, ylabel) in zip(axes, labels, strict=True):
            row[0].set_ylabel(ylabel + " (deviations)" * bool(planes))
            for axis in row:
                axis.set_xlabel(xlabel + " (deviations)")
    return figure


def _describe_inertia(d: int, n_states: int) -> str:
    """What is orange and what grey."""
    if d == 1:
        return f"orange: at {n_states} held-out states; dashed: their mean"
    shown = min(N_ELLIPSES, n_states)
    return f"orange: velocities of equal energy, at {shown} of {n_states} states; grey: at the mean mass"


def _draw_plane(axis: Any, states: np.ndarray, matrices: np.ndarray) -> None:
    axis.plot(*states.T, color=style.ENCODED, linewidth=0.3, alpha=0.12)
    chosen = _choose_distant(states, N_ELLIPSES)
    half = 1.0 / np.sqrt(np.linalg.eigvalsh(matrices))
    scale = ELLIPSE_SHARE * float(np.ptp(states, axis=0).max()) / float(np.median(half))
    mean = np.broadcast_to(matrices.mean(axis=0), matrices[chosen].shape)
    for shapes, colour, fill in ((mean, style.QUIET, 0.35), (matrices[chosen], style.PREDICTED, 0.0)):
        values, vectors = np.linalg.eigh(shapes)
        axes = 2.0 * scale / np.sqrt(values)
        angles = np.degrees(np.arctan2(vectors[:, 1, 0], vectors[:, 0, 0]))
        place = {"offsets": states[chosen], "offset_transform": axis.transData}
        ellipses = EllipseCollection(axes[:, 0], axes[:, 1], angles, units="xy", **place)
        ellipses.set(facecolor=to_rgba(colour, fill), edgecolor="none" if fill else colour, linewidth=0.7)
        axis.add_collection(ellipses)
    axis.margins(0.18)
    axis.set_aspect("equal", adjustable="box")


def _choose_distant(states: np.ndarray, count: int) -> Int64[np.ndarray, " chosen"]:
    """Indices of states that are far from each other, the first one included (farthest-point sampling)."""
    chosen = [0]
    distance = np.linalg.norm(states - states[0], axis=1)
    while len(chosen) < min(count, len(states)):
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(states - states[chosen[-1]], axis=1))
    return np.array(chosen)
