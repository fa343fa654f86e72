"""Training curves."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from lagsplat.report.style import INPUTS, PAGE_IN, new_figure, paper_style


def draw_curves(
    curve: pd.DataFrame, *, title: str, columns: Sequence[str], labels: Mapping[str, str]
) -> Figure:
    """Positive columns of a training curve over its first column, on a logarithmic scale.

    Raises:
        ValueError: a column is not in the curve.
    """
    missing = [name for name in columns if name not in curve]
    if missing:
        raise ValueError(f"the curve has no column {missing}; it has {list(curve.columns)}")
    step = curve.columns[0]
    with paper_style():
        figure = new_figure(PAGE_IN, 2.4, title=title)
        axis = figure.subplots()
        for name, colour in zip(columns, INPUTS, strict=False):
            values = curve[name].to_numpy(dtype=float)
            axis.plot(
                curve[step], np.where(values > 0, values, np.nan), color=colour, label=labels.get(name, name)
            )
        axis.set(yscale="log", xlabel=step)
        axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure
