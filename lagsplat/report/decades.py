"""Logarithmic axes whose labels are plain text."""

import math

from matplotlib.axis import Axis

from lagsplat.report.rounding import power_of_ten

PLAIN = 3  # decades about one that are written out


def plain_decades(axis: Axis) -> None:
    """Label decades as 0.1, 1, 10, far ones as powers, and nothing between."""
    axis.set_major_formatter(lambda x, _: _decade(x))
    axis.set_minor_formatter(lambda x, _: "")


def _decade(x: float) -> str:
    if not x > 0.0:
        return ""
    power = round(math.log10(x))
    return f"{x:g}" if abs(power) <= PLAIN else power_of_ten(power)
