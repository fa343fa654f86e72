"""At which positions and velocities the sim's force is off, before and after the effects."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from lagsplat.diagnose.result import Diagnosis
from lagsplat.report.diagnosis_exhibits import Exhibits
from lagsplat.report.diagnosis_time import coordinate_name
from lagsplat.report.diagnosis_where import located
from lagsplat.report.style import ENCODED, PAGE_IN, PREDICTED, new_figure, paper_style

MOST = 2  # coordinates
STANDS_OUT = 2.0  # standard errors from which a bin is dotted
COLOURS = "PuOr_r"  # told apart with any colour vision, and light in the middle on paper
NOWHERE = "#EEEEEE"


def draw_state_maps(diagnosis: Diagnosis, exhibits: Exhibits) -> Figure | None:
    """Mean residual acceleration over position and velocity, and over position alone; None without maps."""
    before = list(located(diagnosis.where, "maps") or ())
    after = list(exhibits.maps_after)
    shares = located(diagnosis.where, "coordinates") or {}
    there = {one.coordinate for one in before}
    order = sorted(there, key=lambda i: (-shares.get(coordinate_name(diagnosis, i), 0.0), i))[:MOST]
    if not order:
        return None
    columns = 3 if after else 2
    with paper_style():
        figure = new_figure(PAGE_IN, 0.25 + 1.75 * len(order), title="")
        axes = figure.subplots(len(order), columns, squeeze=False)
        for row, at in zip(axes, order, strict=True):
            flat = [one for one in before if one.coordinate == at and len(one.velocity_edges) > 2]
            flat_after = [one for one in after if one.coordinate == at and len(one.velocity_edges) > 2]
            name = coordinate_name(diagnosis, at)
            reach = max((float(np.nanmax(np.abs(one.mean))) for one in flat[:1] if _any(one)), default=0.0)
            panels = [("sim", flat)] + ([("sim with effects", flat_after)] if after else [])
            picture = None
            for axis, (title, maps) in zip(row, panels, strict=False):
                picture = _map(axis, maps, reach, name, title) or picture
            if maps_box := (located(diagnosis.where, "state_region") or {}).get(name):
                _boxes(row[0], maps_box)
            if picture is not None:
                bar = figure.colorbar(picture, ax=list(row[: columns - 1]), pad=0.01, aspect=12)
                bar.set_label(f"real − sim ({name}/s²)")
                bar.outline.set_linewidth(0.5)
            _profile(row[-1], [one for one in before if one.coordinate == at],
                     [one for one in after if one.coordinate == at], name)  # fmt: skip
        return figure


def _any(one: Any) -> bool:
    return bool(np.isfinite(one.mean).any())


def _map(axis: Any, maps: Sequence[Any], reach: float, name: str, title: str) -> Any:
    axis.set_title(title, loc="left", pad=2)
    axis.set(xlabel=name, ylabel=f"{name} rate (1/s)")
    axis.set_facecolor(NOWHERE)
    if not maps or not _any(maps[0]):
        axis.annotate("not computed", (0.5, 0.5), xycoords="axes fraction", ha="center")
        return None
    one = maps[0]
    reach = reach or 1.0
    picture = axis.pcolormesh(
        one.position_edges, one.velocity_edges, np.ma.masked_invalid(one.mean).T, cmap=COLOURS,
        vmin=-reach, vmax=reach, antialiased=False,
    )  # fmt: skip
    rows, columns = np.nonzero((np.abs(one.score) > STANDS_OUT) & np.isfinite(one.mean))
    middle = [0.5 * (edges[1:] + edges[:-1]) for edges in (one.position_edges, one.velocity_edges)]
    axis.plot(middle[0][rows], middle[1][columns], ".", color="black", markersize=1.5)
    return picture


def _boxes(axis: Any, regions: Sequence[Any]) -> None:
    """The regions in which the residual keeps its sign."""
    for region in regions:
        position, velocity = region.get("position"), region.get("velocity")
        if not position or not velocity:
            continue
        corner = (position[0], velocity[0])
        sides = (position[1] - position[0], velocity[1] - velocity[0])
        axis.add_patch(Rectangle(corner, *sides, fill=False, edgecolor="black", linewidth=0.9))


def _profile(axis: Any, before: Sequence[Any], after: Sequence[Any], name: str) -> None:
    """Mean along position or along velocity, whichever the sim's residual varies with more."""
    first = _along(before)
    along = max(first, key=lambda key: float(np.ptp(first[key][1])) if len(first[key][1]) else 0.0)
    for marginals, label, color, line in (
        (first, "sim", PREDICTED, (0, (4, 1.5))),
        (_along(after) if after else {}, "sim with effects", ENCODED, "-"),
    ):
        if along in marginals:
            _steps(axis, *marginals[along], label, color, line)
    axis.axhline(0.0, color="black", linewidth=0.5)
    axis.set(xlabel=name if along == "position" else f"{name} rate (1/s)", ylabel=f"real − sim ({name}/s²)")
    axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.0)


def _along(maps: Sequence[Any]) -> dict[str, tuple[np.ndarray, np.ma.MaskedArray]]:
    """Edges and mean residual along position, and along velocity where a map has both."""
    one = max(maps, key=lambda one: len(one.velocity_edges))
    mean = np.ma.masked_invalid(one.mean)
    found = {"position": (one.position_edges, mean.mean(axis=1))}
    if len(one.velocity_edges) > 2:
        found["velocity"] = (one.velocity_edges, mean.mean(axis=0))
    return found


def _steps(axis: Any, edges: np.ndarray, mean: np.ma.MaskedArray, label: str, color: str, line: Any) -> None:
    axis.stairs(
        np.ma.filled(mean.astype(float), np.nan),
        edges,
        baseline=None,
        label=label,
        color=color,
        linestyle=line,
    )
