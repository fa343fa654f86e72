"""At which frequencies the residual acts, and what it goes with there."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from lagsplat.diagnose.result import Diagnosis
from lagsplat.report.decades import plain_decades
from lagsplat.report.diagnosis_time import EVENT, coordinate_name, coordinate_number
from lagsplat.report.diagnosis_where import located
from lagsplat.report.rounding import number
from lagsplat.report.style import ENCODED, INPUTS, MARK, PAGE_IN, QUIET, new_figure, paper_style

MOST = 6  # curves of coherence
STYLES = ("-", (0, (5, 1)), (0, (1, 1)), (0, (4, 1, 1, 1)), (0, (2, 1)), (0, (6, 2)))


def draw_spectrum(diagnosis: Diagnosis) -> Figure | None:
    """Power of the residual with bands and lines, its coherence with inputs and velocities; None without."""
    found = located(diagnosis.where, "spectrum")
    if found is None:
        return None
    at = coordinate_number(diagnosis)
    with paper_style():
        figure = new_figure(PAGE_IN, 2.1, title="")
        power, coherence = figure.subplots(1, 2)
        _power(power, found, at, coordinate_name(diagnosis, at))
        _coherence(coherence, found, at)
        for axis in (power, coherence):
            axis.set_xscale("log")
            axis.set_xlim(found.frequency_hz[0], found.frequency_hz[-1])
            plain_decades(axis.xaxis)
            axis.set_xlabel("frequency (Hz)")
        return figure


def _power(axis: Any, found: Any, at: int, name: str) -> None:
    label: str | None = "bands with their share"
    for low, high, share in found.bands:
        axis.axvspan(low, high, color=EVENT, alpha=0.45, linewidth=0, zorder=0, label=label)
        axis.annotate(
            f"{100 * share:.0f} %", (np.sqrt(low * high), 0.99), xycoords=("data", "axes fraction"),
            ha="center", va="top", fontsize=6,
        )  # fmt: skip
        label = None
    others: str | None = "of the others"
    for i in range(found.power.shape[1]):
        if found.power[:, i].max() > 0.0:
            color, width = (ENCODED, 1.0) if i == at else (QUIET, 0.5)
            shown = f"residual of {name}" if i == at else others
            others = others if i == at else None
            axis.plot(found.frequency_hz, found.power[:, i], color=color, linewidth=width, label=shown)
    for line in found.lines:
        axis.axvline(line.frequency_hz, color=MARK, linestyle=":")
        axis.annotate(
            f"{number(line.frequency_hz)} Hz", (line.frequency_hz, 0.03), (2, 0), rotation=90, fontsize=6,
            xycoords=("data", "axes fraction"), textcoords="offset points", color=MARK,
        )  # fmt: skip
    if (found.power > 0.0).any():
        axis.set_yscale("log")
        plain_decades(axis.yaxis)
        axis.set_ylim(top=3.0 * found.power.max())
    axis.set_ylabel("power over the swing's (1/Hz)")
    _legend(axis, 3)


def _coherence(axis: Any, found: Any, at: int) -> None:
    height = found.coherence[:, at].max(axis=0, initial=0.0)
    kept = sorted(np.argsort(height)[::-1][:MOST])
    for i, column in enumerate(kept):
        axis.plot(
            found.frequency_hz, found.coherence[:, at, column], color=INPUTS[i % len(INPUTS)],
            linestyle=STYLES[i % len(STYLES)], label=_called(found.names[column]),
        )  # fmt: skip
    axis.axhline(found.significant, color="black", linewidth=0.5, linestyle="--")
    axis.annotate(
        "1 in 100 by chance", (0.01, found.significant), (0, 1), va="bottom", fontsize=6,
        xycoords=("axes fraction", "data"), textcoords="offset points",
    )  # fmt: skip
    axis.set(ylim=(0.0, 1.02), ylabel="coherence with")
    if kept:
        _legend(axis, min(len(kept), 4))


def _called(name: str) -> str:
    return f"rate of {name.removeprefix('v_')}" if name.startswith("v_") else name


def _legend(axis: Any, columns: int) -> None:
    axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns, borderaxespad=0.0)
