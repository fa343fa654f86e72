"""Which effects a recording tells apart, what its residual goes with, how sharply it bounds numbers."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from lagsplat.diagnose.profile import Profile
from lagsplat.diagnose.result import Diagnosis
from lagsplat.report.decades import plain_decades
from lagsplat.report.diagnosis_exhibits import Exhibits
from lagsplat.report.diagnosis_names import chosen
from lagsplat.report.effect_words import short_title
from lagsplat.report.rounding import number, unit, values
from lagsplat.report.style import ENCODED, PAGE_IN, PREDICTED, QUIET, new_figure, paper_style

TELLS = 3.0  # nats below which two effects are not told apart
FALL = 1.353  # nats at the ends of a 90 % interval
COLOURS = "cividis"
MOST = 6  # profiles
WIDE = 20.0  # from the smallest to the largest value: then the axis is logarithmic
DEEPEST = 12.0  # nats shown


def draw_separability(exhibits: Exhibits) -> Figure | None:
    """How many nats tell the effect of a row from that of a column; None where not computed."""
    found = exhibits.separability
    if found is None:
        return None
    n = len(found.names)
    names = [short_title(name) for name in found.names]
    with paper_style():
        figure = new_figure(min(PAGE_IN, 2.6 + 0.42 * n), 1.3 + 0.24 * n, title="")
        axis = figure.subplots()
        nats = np.where(np.eye(n, dtype=bool), np.nan, found.nats)
        shown = np.log10(np.clip(nats, 0.1, 1e3))
        picture = axis.imshow(np.ma.masked_invalid(shown), cmap=COLOURS, vmin=-1.0, vmax=3.0, aspect="auto")
        for i, j in np.ndindex(n, n):
            if not np.isfinite(nats[i, j]):
                continue
            dark = shown[i, j] < 1.0
            axis.text(j, i, number(float(nats[i, j])), ha="center", va="center", fontsize=6,
                      color="white" if dark else "black")  # fmt: skip
            if nats[i, j] < TELLS:
                axis.add_patch(Rectangle((j - 0.46, i - 0.44), 0.92, 0.88, fill=False, edgecolor=PREDICTED,
                                         linewidth=1.3))  # fmt: skip
        axis.set_xticks(range(n), names, rotation=35, ha="right", rotation_mode="anchor")
        axis.set_yticks(range(n), names)
        axis.spines[:].set_visible(False)
        axis.tick_params(length=0)
        bar = figure.colorbar(picture, ax=axis, pad=0.01, ticks=[-1, 0, 1, 2, 3])
        bar.ax.set_yticklabels(["≤ 0.1", "1", "10", "100", "≥ 1000"])
        bar.set_label("nats; framed: not told apart (< 3)")
        bar.outline.set_linewidth(0.5)
        return figure


def draw_fingerprint(exhibits: Exhibits) -> Figure | None:
    """Tests of the residual against what may drive it, over their 5 % bounds; None where not computed."""
    found = exhibits.fingerprint
    if found is None:
        return None
    with paper_style():
        rows, columns = found.score.shape
        figure = new_figure(min(PAGE_IN, 1.8 + 0.36 * columns), 0.95 + 0.24 * rows, title="")
        axis = figure.subplots()
        shown = np.log2(np.clip(found.score, 0.25, 16.0))
        picture = axis.imshow(shown, cmap=COLOURS, vmin=-2.0, vmax=4.0, aspect="auto")
        for i, j in np.argwhere(found.score > 1.0):
            axis.plot(j, i, "o", color="white", markeredgecolor="black", markersize=4.0, markeredgewidth=0.6)
        axis.set_xticks(
            range(columns), list(found.regressors), rotation=35, ha="right", rotation_mode="anchor"
        )
        axis.set_yticks(range(rows), list(found.coordinates))
        axis.spines[:].set_visible(False)
        axis.tick_params(length=0)
        bar = figure.colorbar(picture, ax=axis, pad=0.01, ticks=[-2, 0, 2, 4])
        bar.ax.set_yticklabels(["≤ ¼", "1", "4", "≥ 16"])
        bar.set_label("statistic over\nits 5 % bound")
        bar.outline.set_linewidth(0.5)
        return figure


def draw_profiles(diagnosis: Diagnosis, exhibits: Exhibits) -> Figure | None:
    """Likelihood along each parameter with its 90 % interval; None where not computed."""
    shown = exhibits.profiles[:MOST]
    if not shown:
        return None
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    with paper_style():
        figure = new_figure(PAGE_IN * columns / 3.0, 0.15 + 1.55 * rows, title="")
        axes = figure.subplots(rows, columns, squeeze=False, sharey=True)
        for axis, one in zip(axes.flat, shown, strict=False):
            _profile(axis, diagnosis, one)
        for axis in axes.flat[len(shown) :]:
            axis.set_visible(False)
        for row in axes:
            row[0].set_ylabel("log-likelihood\nbelow its best (nat)")
        return figure


def _profile(axis: Any, diagnosis: Diagnosis, one: Profile) -> None:
    fall = one.log_likelihood - np.max(one.log_likelihood)
    if np.min(one.values) > 0.0 and np.max(one.values) > WIDE * np.min(one.values):
        axis.set_xscale("log")
        plain_decades(axis.xaxis)
    axis.plot(one.values, fall, "o-", color=ENCODED, markersize=2.5)
    axis.axhline(-FALL, color=QUIET, linestyle="--", linewidth=0.6)
    for candidate in [*chosen(diagnosis), *diagnosis.candidates]:
        fitted = candidate.parameters.get(one.parameter) if candidate.name == one.effect else None
        if fitted is not None and len(values(fitted.value)) == 1:
            low, high = values(fitted.low), values(fitted.high)
            if low and high:
                axis.axvspan(low[0], high[0], color=PREDICTED, alpha=0.2, linewidth=0)
            axis.axvline(values(fitted.value)[0], color=PREDICTED)
            break
    given = f" ({unit(one.unit)})" if unit(one.unit) else ""
    axis.set_xlabel(f"{one.parameter.replace('_', ' ')}{given}")
    axis.set_title(short_title(one.effect), loc="left", pad=2)
    axis.set_ylim(max(-DEEPEST, 1.1 * float(np.min(fall))) - 0.1, 0.5)
