"""Numbers as people read them: as many digits as their uncertainty bears."""

import math
import re
from typing import Any

MOST_CERTAIN = 0.99
MINUS = "\N{MINUS SIGN}"


def number(value: float, *, digits: int = 2) -> str:
    """``value`` to so many significant digits, without an exponent between a thousandth and a million."""
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
        text = f"{mantissa}·{power_of_ten(int(exponent))}"
    return text.replace("-", MINUS)


def spread(value: float, low: float | None, high: float | None) -> tuple[str, str, str]:
    """Value and bounds, all to the decimal place at which the interval has two digits.

    Without finite bounds the value has three digits and the bounds are dashes.
    """
    if low is None or high is None or not (math.isfinite(low) and math.isfinite(high)):
        return number(value, digits=3), _bound(low), _bound(high)
    width = high - low
    if not width > 0.0:
        return number(value, digits=3), number(low, digits=3), number(high, digits=3)
    # More than six digits say nothing even where the interval is narrower still.
    most = 5 - math.floor(math.log10(max(abs(value), abs(low), abs(high))))
    places = min(1 - math.floor(math.log10(width)), most)
    if places > 6 or places < -4:
        return number(value, digits=3), number(low, digits=3), number(high, digits=3)
    first, second, third = (_at_place(x, places) for x in (value, low, high))
    return first, second, third


def percent(share: float) -> str:
    """A share in percent: whole numbers, and a decimal below ten."""
    if not math.isfinite(share):
        return number(share)
    value = 100.0 * share
    text = f"{value:.0f}" if abs(value) >= 9.95 or value == 0.0 else f"{value:.1f}"
    if float(text) == 0.0 and value != 0.0:
        return "< 0.1 %" if value > 0.0 else f"> {MINUS}0.1 %"
    return f"{text.replace('-', MINUS)} %"


def probability(p: float) -> str:
    """A probability, never more certain than a model of the data can be: between 0.01 and 0.99."""
    if p < 0.01:
        return "< 0.01"
    return f"{min(p, MOST_CERTAIN):.2f}"


def unit(name: str) -> str:
    """A unit with raised powers; nothing for a pure number."""
    if name in ("", "1"):
        return ""
    return re.sub(r"\^(-?\d+)", lambda found: _raised(int(found.group(1))), name)


def with_unit(text: str, name: str) -> str:
    """A number and its unit, on one line."""
    return f"{text}\N{NO-BREAK SPACE}{unit(name)}" if unit(name) else text


def power_of_ten(power: int) -> str:
    """Such as 10⁻³."""
    return f"10{_raised(power)}"


def values(value: Any) -> list[float]:
    """One number or several, as a list; numbers that are not there are left out."""
    several = value if isinstance(value, list | tuple) else [value]
    return [float(one) for one in several if one is not None]


def _at_place(value: float, places: int) -> str:
    rounded = round(value, places) + 0.0  # no negative zero
    return f"{rounded:.{max(places, 0)}f}".replace("-", MINUS)


def _bound(value: float | None) -> str:
    return "–" if value is None else number(value, digits=3)


def _raised(power: int) -> str:
    return str(power).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
