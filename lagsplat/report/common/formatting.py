"""Numbers, units and tables as text: with Unicode for pages and figures, and in LaTeX."""

import math
import re
from collections.abc import Iterable
from typing import Any

MAX_PROBABILITY = 0.99  # no model of the data makes anything more certain
MINUS = "\N{MINUS SIGN}"
RAISED = "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"
LOWERED = str.maketrans(RAISED, "-0123456789")
LATEX_ESCAPES = {
    **{letter: "\\" + letter for letter in "_%&#${}"},
    **{"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"},
    **{MINUS: "$-$", "·": r"$\cdot$", "×": r"$\times$", "°": r"$^\circ$", "∞": r"$\infty$", "–": "--"},
    **{"<": "$<$", ">": "$>$"},
}


def format_number(value: float, *, digits: int = 2) -> str:
    """Format ``value`` to so many significant digits; below 0.001 and from a million on with an exponent."""
    if not math.isfinite(value):
        return "not finite" if math.isnan(value) else f"{MINUS if value < 0 else ''}∞"
    if value == 0.0:
        return "0"
    places = digits - 1 - math.floor(math.log10(abs(value)))
    rounded = round(value, places)
    if 1e-3 <= abs(rounded) < 1e6:
        # Rounding can have carried into a further digit, as from 0.996 to 1.0.
        places = min(places, digits - 1 - math.floor(math.log10(abs(rounded))))
        text = f"{rounded:.{max(places, 0)}f}"
    else:
        mantissa, _, exponent = f"{rounded:.{digits - 1}e}".partition("e")
        text = f"{mantissa}·{format_power_of_ten(int(exponent))}"
    return text.replace("-", MINUS)


def format_interval(
    value: float, low: float | None, high: float | None, *, most_digits: int = 6
) -> tuple[str, str, str]:
    """Format a value and its bounds, all to the decimal place at which the interval has two digits.

    No number has more than ``most_digits``. Without an interval of finite width each has three digits, and a
    missing bound is a dash.
    """
    if low is not None and high is not None and math.isfinite(low) and math.isfinite(high) and high > low:
        last_place = most_digits - 1 - math.floor(math.log10(max(abs(value), abs(low), abs(high))))
        places = min(1 - math.floor(math.log10(high - low)), last_place)
        if -4 <= places <= 6:
            return _round_to_place(value, places), _round_to_place(low, places), _round_to_place(high, places)
    bounds = ["–" if bound is None else format_number(bound, digits=3) for bound in (low, high)]
    return format_number(value, digits=3), bounds[0], bounds[1]


def format_percent(share: float) -> str:
    """Format a share in percent: whole numbers, and a decimal below ten."""
    if not math.isfinite(share):
        return format_number(share)
    value = 100.0 * share
    text = f"{value:.0f}" if abs(value) >= 9.95 or value == 0.0 else f"{value:.1f}"
    if float(text) == 0.0 and value != 0.0:
        return "< 0.1 %" if value > 0.0 else f"> {MINUS}0.1 %"
    return f"{text.replace('-', MINUS)} %"


def format_probability(p: float) -> str:
    """Format a probability between 0.01 and 0.99, for no model of the data is more certain."""
    if p < 0.01:
        return "< 0.01"
    return f"{min(p, MAX_PROBABILITY):.2f}"


def format_unit(name: str) -> str:
    """Format a unit with raised powers; empty for a pure number."""
    return "" if name == "1" else re.sub(r"\^(-?\d+)", lambda match: _raise_power(int(match.group(1))), name)


def append_unit(text: str, name: str) -> str:
    """Append a unit to a number, so that both stay on one line."""
    unit = format_unit(name)
    return f"{text}\N{NO-BREAK SPACE}{unit}" if unit else text


def format_power_of_ten(power: int) -> str:
    """Format a power of ten, such as 10⁻³."""
    return f"10{_raise_power(power)}"


def list_numbers(value: Any) -> list[float]:
    """List one number or several, without those that are missing."""
    several = value if isinstance(value, list | tuple) else [value]
    return [float(number) for number in several if number is not None]


def _round_to_place(value: float, places: int) -> str:
    rounded = round(value, places) + 0.0  # no negative zero
    return f"{rounded:.{max(places, 0)}f}".replace("-", MINUS)


def _raise_power(power: int) -> str:
    return str(power).translate(str.maketrans("-0123456789", RAISED))


def escape_latex(text: str) -> str:
    """Escape plain text, so that LaTeX prints it as it is, powers raised."""
    plain = "".join(LATEX_ESCAPES.get(letter, letter) for letter in text)
    return re.sub(f"[{RAISED}]+", lambda power: f"$^{{{power.group().translate(LOWERED)}}}$", plain)


def capitalize_first(text: str) -> str:
    """Make the first letter a capital and leave the others, as of names, alone."""
    return text[:1].upper() + text[1:]


def join_distinct(values: Iterable[Any]) -> str:
    """Join the different values in alphabetical order, such as "quick and toy"."""
    return " and ".join(sorted({str(value) for value in values}))
