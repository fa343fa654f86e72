"""Numbers, units and tables as text: with Unicode for pages and figures, and in LaTeX."""

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import pandas as pd

MAX_PROBABILITY = 0.99  # no model of the data makes anything more certain
MINUS = "\N{MINUS SIGN}"
LATEX_ESCAPES = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"} | {
    letter: "\\" + letter for letter in "_%&#${}"
}
# With booktabs loaded these three do nothing; without it the table still compiles.
BOOKTABS_FALLBACK = (
    r"\providecommand{\toprule}{\hline}"
    r"\providecommand{\midrule}{\hline}"
    r"\providecommand{\bottomrule}{\hline}"
)


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


def format_interval(value: float, low: float | None, high: float | None) -> tuple[str, str, str]:
    """Format a value and its bounds, all to the decimal place at which the interval has two digits.

    Without an interval of finite width each has three digits, and a missing bound is a dash.
    """
    if low is not None and high is not None and math.isfinite(low) and math.isfinite(high) and high > low:
        # Six digits are enough even where the interval is narrower still.
        last_place = 5 - math.floor(math.log10(max(abs(value), abs(low), abs(high))))
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
    return str(power).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def format_latex_table(
    *, head: Sequence[str], body: Sequence[str], alignment: str, caption: str, label: str
) -> str:
    """Format a floating table over both columns of the page, for ``\\input`` in any article.

    ``head`` and ``body`` are lines of LaTeX above and below the first rule, ``alignment`` one letter a
    column, such as ``lcc``. The caption is plain text, and the label a name for ``\\ref``.
    """
    lines = [
        BOOKTABS_FALLBACK,
        r"\begin{table*}",
        r"\centering\footnotesize\setlength{\tabcolsep}{3pt}",
        rf"\caption{{{escape_latex(caption)}}}",
        rf"\label{{{label}}}",
        rf"\begin{{tabular}}{{@{{}}{alignment}@{{}}}}",
        r"\toprule",
        *head,
        *body,
        r"\bottomrule",
        r"\end{tabular}",
        r"\end{table*}",
        "",
    ]
    return "\n".join(lines)


def format_grouped_table(
    frame: pd.DataFrame,
    *,
    by: str,
    titles: Mapping[str, str],
    row: Callable[[Mapping[Any, Any]], str],
    head: Sequence[str],
    alignment: str,
    caption: str,
    label: str,
) -> str:
    """Format a table whose rows stand in blocks: one for each value of the column ``by``, under its title.

    ``row`` formats one row as a line of LaTeX. A block without a title bears its name. The other arguments
    are those of `format_latex_table`.
    """
    body = []
    for name, block in frame.groupby(by, sort=False):
        body.append(format_block_title(titles.get(str(name), str(name)), columns=len(alignment)))
        body += [row(record) for record in block.to_dict("records")]
    return format_latex_table(head=head, body=body, alignment=alignment, caption=caption, label=label)


def format_block_title(title: str, *, columns: int) -> str:
    """Format the line that heads a block of rows."""
    return rf"\midrule \multicolumn{{{columns}}}{{@{{}}l}}{{\emph{{{escape_latex(title)}}}}} \\"


def format_cells(*texts: str) -> str:
    """Format one row of a table."""
    return " & ".join(texts) + r" \\"


def format_latex_number(value: float | None, low: float | None = None, high: float | None = None) -> str:
    """Format a value with three digits and, smaller, its spread; a dash where nothing was measured."""
    if value is None or pd.isna(value):
        return "--"
    text = format_digits(value)
    if low is None or high is None or pd.isna(low) or pd.isna(high):
        return f"${text}$"
    return rf"${text}\,{{\scriptstyle[{format_digits(low)},\,{format_digits(high)}]}}$"


def rescale(value: float | None, scale: float) -> float | None:
    """Convert ``value`` to another unit; None where nothing was measured."""
    return None if value is None or pd.isna(value) else scale * value


def format_digits(value: float) -> str:
    """Format three significant digits without an exponent, so that columns can be compared by eye."""
    text = f"{value:.3g}"
    return f"{value:.0f}" if "e+" in text else f"{value:.6f}".rstrip("0").rstrip(".") if "e" in text else text


def escape_latex(text: str) -> str:
    """Escape plain text, so that LaTeX prints it as it is."""
    return "".join(LATEX_ESCAPES.get(letter, letter) for letter in text)


def join_distinct(values: Iterable[Any]) -> str:
    """Join the different values in alphabetical order, such as "quick and toy"."""
    return " and ".join(sorted({str(value) for value in values}))
