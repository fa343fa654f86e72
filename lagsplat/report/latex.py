"""Numbers, words and whole tables in LaTeX; booktabs is used where it is loaded."""

from collections.abc import Sequence

import pandas as pd

SPECIAL = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"} | {
    letter: "\\" + letter for letter in "_%&#${}"
}
# With booktabs loaded these three do nothing; without it the table still compiles.
RULES = (
    r"\providecommand{\toprule}{\hline}"
    r"\providecommand{\midrule}{\hline}"
    r"\providecommand{\bottomrule}{\hline}"
)


def latex_float(
    *, head: Sequence[str], body: Sequence[str], columns: str, caption: str, label: str, wide: bool = True
) -> str:
    """A floating table for ``\\input`` in any article, over both columns of its page if ``wide``.

    ``head`` and ``body`` are lines of LaTeX, ``columns`` the tabular's specification; ``caption`` is plain
    text.
    """
    environment = "table*" if wide else "table"
    return "\n".join(
        [
            RULES,
            rf"\begin{{{environment}}}",
            r"\centering\footnotesize\setlength{\tabcolsep}{3pt}",
            rf"\caption{{{escape(caption)}}}",
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


def block_title(title: str, *, columns: int) -> str:
    """The line that heads a block of rows."""
    return rf"\midrule \multicolumn{{{columns}}}{{@{{}}l}}{{\emph{{{escape(title)}}}}} \\"


def cells(*texts: str) -> str:
    """One row of a table."""
    return " & ".join(texts) + r" \\"


def number(value: float | None, low: float | None = None, high: float | None = None) -> str:
    """Three digits and, smaller, the spread; a dash where nothing was measured."""
    if value is None or pd.isna(value):
        return "--"
    text = digits(value)
    if low is None or high is None or pd.isna(low) or pd.isna(high):
        return f"${text}$"
    return rf"${text}\,{{\scriptstyle[{digits(low)},\,{digits(high)}]}}$"


def scaled(value: float | None, scale: float) -> float | None:
    """``value`` in another unit, or still nothing."""
    return None if value is None or pd.isna(value) else scale * value


def digits(value: float) -> str:
    """Three significant digits in plain notation, so that columns can be compared by eye."""
    text = f"{value:.3g}"
    return f"{value:.0f}" if "e+" in text else f"{value:.6f}".rstrip("0").rstrip(".") if "e" in text else text


def escape(text: str) -> str:
    """Plain text as LaTeX prints it."""
    return "".join(SPECIAL.get(letter, letter) for letter in text)
