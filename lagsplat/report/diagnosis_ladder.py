"""The ladder from picture to forecast, and the steps by which a gap closes."""

import math

from matplotlib.figure import Figure

from lagsplat.diagnose.result import Diagnosis, Gap
from lagsplat.report.diagnosis_exhibits import Exhibits
from lagsplat.report.diagnosis_names import chosen, place
from lagsplat.report.rounding import number, percent
from lagsplat.report.style import ENCODED, MARK, PAGE_IN, PREDICTED, QUIET, new_figure, paper_style

INK = "#222222"


def draw_ladder(exhibits: Exhibits) -> Figure | None:
    """Each rung's error over its floor with its 95 % interval; None without rungs that have a floor."""
    rungs = [one for one in exhibits.rungs if one.floor is not None and one.floor > 0.0]
    if not rungs:
        return None
    with paper_style():
        figure = new_figure(PAGE_IN, 0.55 + 0.24 * len(rungs), title="")
        axis = figure.subplots()
        for row, one in enumerate(rungs):
            value, low, high = (x / one.floor for x in (one.value, one.low, one.high))
            axis.plot([1.0, value], [row, row], color=QUIET, linewidth=4.0, alpha=0.35, solid_capstyle="butt")
            axis.plot([low, high], [row, row], color=INK, linewidth=1.0)
            axis.plot(value, row, "o", color=PREDICTED, markersize=4.5)
            told = f"{number(one.value)} over a floor of {number(one.floor)}"
            axis.annotate(told, (1.01, row), xycoords=("axes fraction", "data"), va="center", fontsize=6.5)
        axis.axvline(1.0, color=MARK, linestyle="--")
        axis.set_yticks(range(len(rungs)), [one.name for one in rungs])
        axis.set_xscale("log")
        axis.xaxis.set_major_formatter(lambda x, _: f"{x:g}")
        axis.xaxis.set_minor_formatter(lambda x, _: f"{x:g}" if _leading(x) in (2, 5) else "")
        axis.set(ylim=(len(rungs) - 0.5, -0.5), xlabel="error in multiples of its floor (dashed)")
        return figure


def draw_waterfall(diagnosis: Diagnosis, exhibits: Exhibits) -> Figure | None:
    """From the sim as delivered down to the floor: what a refit takes away, and what each effect takes."""
    gap = diagnosis.gap
    if gap is None:
        return None
    steps = _steps(diagnosis, gap, exhibits)
    with paper_style():
        lines = max(label.count("\n") for label, _ in steps) if steps else 1
        figure = new_figure(0.75 * PAGE_IN, 2.0 + 0.12 * lines, title="")
        axis = figure.subplots()
        axis.bar(0, gap.before, color=QUIET, width=0.6)
        axis.annotate(percent(gap.before), (0, gap.before), (0, 2), textcoords="offset points", ha="center")
        level = gap.before
        for column, (_, value) in enumerate(steps, start=1):
            color = ENCODED if column > 1 or not math.isfinite(gap.refit) else "#56B4E9"
            axis.bar(column, value - level, bottom=level, color=color, width=0.6)
            axis.plot([column - 0.7, column + 0.3], [level, level], color=INK, linewidth=0.5)
            shift = f"{'' if value > level else '−'}{percent(abs(value - level))}"
            axis.annotate(shift, (column, max(level, value)), (0, 2), textcoords="offset points", ha="center")
            level = value
        last = len(steps) + 1
        axis.bar(last, gap.after, color=PREDICTED, width=0.6)
        axis.plot([last - 0.7, last + 0.3], [level, level], color=INK, linewidth=0.5)
        top = _after_bar(axis, last, gap)
        axis.annotate(percent(gap.after), (last, top), (0, 2), textcoords="offset points", ha="center")
        labels = ["sim as\ndelivered", *(label for label, _ in steps), "what\nremains"]
        axis.set_xticks(range(last + 1), labels)
        if math.isfinite(gap.floor):
            axis.axhline(gap.floor, color=MARK, linestyle="--")
            axis.annotate(
                f"floor {percent(gap.floor)}", (1.0, gap.floor), (2, 0), va="center", color=MARK,
                xycoords=("axes fraction", "data"), textcoords="offset points", annotation_clip=False,
            )  # fmt: skip
        axis.set_ylim(0.0, 1.12 * max(gap.before, top, *(value for _, value in steps)))
        axis.yaxis.set_major_formatter(lambda y, _: f"{100 * y:g} %")
        axis.set_ylabel("gap (share of rms)")
        return figure


def _leading(x: float) -> int:
    return round(x / 10.0 ** math.floor(math.log10(x)))


def _steps(diagnosis: Diagnosis, gap: Gap, exhibits: Exhibits) -> list[tuple[str, float]]:
    steps = [("refit within\nuncertainty", gap.refit)] if math.isfinite(gap.refit) else []
    if exhibits.steps:
        return steps + [(_wrapped(label), value) for label, value in exhibits.steps]
    named = [place(one) for one in chosen(diagnosis)] if diagnosis.combination else []
    if named:
        steps.append(("\n".join(_wrapped(f"+ {name}") for name in named), gap.after))
    return steps


def _after_bar(axis: object, column: int, gap: Gap) -> float:
    """The interval of what remains, from that of the closure; its upper end."""
    closure = gap.closure
    if closure.low is None or closure.high is None or not math.isfinite(gap.floor):
        return gap.after
    low, high = (gap.before - share * (gap.before - gap.floor) for share in (closure.high, closure.low))
    axis.plot([column, column], [max(low, 0.0), high], color=INK, linewidth=1.0)  # type: ignore[attr-defined]
    return max(high, gap.after)


def _wrapped(text: str) -> str:
    """Broken before the place, so that neighbours do not touch."""
    for word in (" at ", " of "):
        head, found, tail = text.rpartition(word)
        if found:
            return f"{head}\n{found.strip()} {tail}"
    return text
