"""Numbers, words and whole tables in LaTeX; booktabs is used where it is loaded.

Numbers as people read them: as many digits as their uncertainty bears.
"""

import math
import re
from collections.abc import Sequence
from typing import Any

import pandas as pd

LATEX_ESCAPES = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"} | {
    letter: "\\" + letter for letter in "_%&#${}"
}
# With booktabs loaded these three do nothing; without it the table still compiles.
BOOKTABS_FALLBACK = (
    r"\providecommand{\toprule}{\hline}"
    r"\providecommand{\midrule}{\hline}"
    r"\providecommand{\bottomrule}{\hline}"
)


def format_latex_table(
    *, head: Sequence[str], body: Sequence[str], columns: str, caption: str, label: str, wide: bool = True
) -> str:
    """A floating table for ``\\input`` in any article, over both columns of its page if ``wide``.

    ``head`` and ``body`` are lines of LaTeX, ``columns`` the tabular's specification; ``caption`` is plain
    text.
    """
    environment = "table*" if wide else "table"
    return "\n".join(
        [
            BOOKTABS_FALLBACK,
            rf"\begin{{{environment}}}",
            r"\centering\footnotesize\setlength{\tabcolsep}{3pt}",
            rf"\caption{{{escape_latex(caption)}}}",
            rf"\label{{{label}}}",
            rf"\begin{{tabular}}{{{columns}}}",
            r"\toprule",
            *head,
            *body,
            r"\bottomrule",
            r"\end{tabular}",
            rf"\end{{{environment}}}",
            "",
        ]
    )


def format_block_title(title: str, *, columns: int) -> str:
    """The line that heads a block of rows."""
    return rf"\midrule \multicolumn{{{columns}}}{{@{{}}l}}{{\emph{{{escape_latex(title)}}}}} \\"


def format_cells(*texts: str) -> str:
    """One row of a table."""
    return " & ".join(texts) + r" \\"


def format_latex_number(value: float | None, low: float | None = None, high: float | None = None) -> str:
    """Three digits and, smaller, the spread; a dash where nothing was measured."""
    if value is None or pd.isna(value):
        return "--"
    text = format_digits(value)
    if low is None or high is None or pd.isna(low) or pd.isna(high):
        return f"${text}$"
    return rf"${text}\,{{\scriptstyle[{format_digits(low)},\,{format_digits(high)}]}}$"


def rescale(value: float | None, scale: float) -> float | None:
    """``value`` in another unit, or still nothing."""
    return None if value is None or pd.isna(value) else scale * value


def format_digits(value: float) -> str:
    """Three significant digits in plain notation, so that columns can be compared by eye."""
    text = f"{value:.3g}"
    return f"{value:.0f}" if "e+" in text else f"{value:.6f}".rstrip("0").rstrip(".") if "e" in text else text


def escape_latex(text: str) -> str:
    """Plain text as LaTeX prints it."""
    return "".join(LATEX_ESCAPES.get(letter, letter) for letter in text)


MAX_PROBABILITY = 0.99
MINUS = "\N{MINUS SIGN}"


def format_number(value: float, *, digits: int = 2) -> str:
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
        text = f"{mantissa}·{format_power_of_ten(int(exponent))}"
    return text.replace("-", MINUS)


def format_interval(value: float, low: float | None, high: float | None) -> tuple[str, str, str]:
    """Value and bounds, all to the decimal place at which the interval has two digits.

    Without finite bounds the value has three digits and the bounds are dashes.
    """
    if low is None or high is None or not (math.isfinite(low) and math.isfinite(high)):
        return format_number(value, digits=3), _bound(low), _bound(high)
    width = high - low
    if not width > 0.0:
        return format_number(value, digits=3), format_number(low, digits=3), format_number(high, digits=3)
    # More than six digits say nothing even where the interval is narrower still.
    most = 5 - math.floor(math.log10(max(abs(value), abs(low), abs(high))))
    places = min(1 - math.floor(math.log10(width)), most)
    if places > 6 or places < -4:
        return format_number(value, digits=3), format_number(low, digits=3), format_number(high, digits=3)
    first, second, third = (_at_place(x, places) for x in (value, low, high))
    return first, second, third


def format_percent(share: float) -> str:
    """A share in percent: whole numbers, and a decimal below ten."""
    if not math.isfinite(share):
        return format_number(share)
    value = 100.0 * share
    text = f"{value:.0f}" if abs(value) >= 9.95 or value == 0.0 else f"{value:.1f}"
    if float(text) == 0.0 and value != 0.0:
        return "< 0.1 %" if value > 0.0 else f"> {MINUS}0.1 %"
    return f"{text.replace('-', MINUS)} %"


def format_probability(p: float) -> str:
    """A probability, never more certain than a model of the data can be: between 0.01 and 0.99."""
    if p < 0.01:
        return "< 0.01"
    return f"{min(p, MAX_PROBABILITY):.2f}"


def format_unit(name: str) -> str:
    """A unit with raised powers; nothing for a pure number."""
    if name in ("", "1"):
        return ""
    return re.sub(r"\^(-?\d+)", lambda found: _raised(int(found.group(1))), name)


def append_unit(text: str, name: str) -> str:
    """A number and its unit, on one line."""
    return f"{text}\N{NO-BREAK SPACE}{format_unit(name)}" if format_unit(name) else text


def format_power_of_ten(power: int) -> str:
    """Such as 10⁻³."""
    return f"10{_raised(power)}"


def list_numbers(value: Any) -> list[float]:
    """One number or several, as a list; numbers that are not there are left out."""
    several = value if isinstance(value, list | tuple) else [value]
    return [float(one) for one in several if one is not None]


def _at_place(value: float, places: int) -> str:
    rounded = round(value, places) + 0.0  # no negative zero
    return f"{rounded:.{max(places, 0)}f}".replace("-", MINUS)


def _bound(value: float | None) -> str:
    return "–" if value is None else format_number(value, digits=3)


def _raised(power: int) -> str:
    return str(power).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
