"""Tables in print and on a page: columns, digits, best values and notes are said once for both."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import pandas as pd
from jinja2 import Environment, PackageLoader, StrictUndefined

from lagsplat.io.files.atomic import write_text
from lagsplat.report.common.formatting import escape_latex, format_interval, format_number

DASH = "–"
DASH_NOTE = "A dash: not measured, or not reported."
BOLD_NOTE = "Bold: the best of those that can be compared."
MOST_DIGITS = 4  # of a number with an interval
MOST_LINES = 36  # of one float, which then stays with caption and notes below the height of a page
TEXT_WIDTH_PT = 410.0  # of an article of two columns, at 10 points
DIGIT_PT = 4.25  # width at \footnotesize; letters have about the same, and these half of it
NARROW = frozenset(" .,:;'!|()[]ijlt")
SMALLER = 0.9  # of a character in the next smaller type, to one in this
# With booktabs loaded these three do nothing; without it the table still compiles.
BOOKTABS_FALLBACK = (
    r"\providecommand{\toprule}{\hline}"
    r"\providecommand{\midrule}{\hline}"
    r"\providecommand{\bottomrule}{\hline}"
)
Row = Mapping[Any, Any]
Blocks = Sequence[tuple[str, list[list["Cell"]]]]
"""Rows of cells, below the title of their block."""


class Cell(NamedTuple):
    """What stands in a cell: its text, a bracket in smaller type, a raised mark, and how it is set."""

    text: str
    small: str = ""
    mark: str = ""
    bold: bool = False
    italic: bool = False


class Column(NamedTuple):
    """One column: two lines of heading, one shared with its neighbours, and how a row's cell is written.

    ``rank`` gives what is lowest in the best row, None where nothing was measured; without it nothing is
    bold. Texts break into lines of ``wrap_em``. ``note`` is printed below the table.
    """

    title: str
    write: Callable[[Row], Cell]
    below: str = ""
    over: str = ""
    rank: Callable[[Row], float | None] | None = None
    wrap_em: float | None = None
    is_number: bool = True
    note: str = ""


class PrintedTable(NamedTuple):
    """A table ready to be written: rows of cells in titled blocks. ``lead`` opens the caption in bold."""

    label: str
    lead: str
    caption: str
    columns: list[Column]
    blocks: Blocks
    notes: list[str]


def lay_out(
    frame: pd.DataFrame,
    columns: Sequence[Column],
    *,
    label: str,
    lead: str,
    caption: str,
    block: Callable[[Row], str],
    compared: Sequence[str] = ("system", "recording"),
    notes: Sequence[str] = (),
) -> PrintedTable:
    """Lay out the rows of ``frame`` in blocks titled by ``block``, in the order of their first row.

    A value is bold where it is the best of several in rows that agree in the columns ``compared``. A column
    without a single value is left out. Below the table stand the notes of its columns, ``notes``, and what
    bold type and a dash mean where they occur.
    """
    rows = frame.to_dict("records")
    cells = [[column.write(row) for column in columns] for row in rows]
    for place, column in enumerate(columns):
        for index in _find_best(rows, [line[place].text for line in cells], column, compared):
            cells[index][place] = cells[index][place]._replace(bold=True)
    kept = [place for place in range(len(columns)) if any(line[place].text != DASH for line in cells)]
    blocks: dict[str, list[list[Cell]]] = {}
    for row, line in zip(rows, cells, strict=True):
        blocks.setdefault(block(row), []).append([line[place] for place in kept])
    shown = [cell for lines in blocks.values() for line in lines for cell in line]
    of_columns = dict.fromkeys(columns[place].note for place in kept if columns[place].note)
    told = [*of_columns, *filter(None, notes), *([BOLD_NOTE] if any(cell.bold for cell in shown) else [])]
    told += [DASH_NOTE] if any(cell.text == DASH for cell in shown) else []
    return PrintedTable(label, lead, caption, [columns[place] for place in kept], list(blocks.items()), told)


def _find_best(
    rows: Sequence[Row], texts: Sequence[str], column: Column, compared: Sequence[str]
) -> Iterable[int]:
    """Rows whose printed value is the best of at least two that can be compared."""
    if column.rank is None:
        return
    groups: dict[tuple[Any, ...], list[tuple[float, int]]] = {}
    for index, row in enumerate(rows):
        rank = column.rank(row)
        if rank is not None and not pd.isna(rank):
            groups.setdefault(tuple(row.get(key) for key in compared), []).append((rank, index))
    for ranked in groups.values():
        winner = texts[min(ranked)[1]]
        if len(ranked) > 1 and any(texts[index] != winner for _, index in ranked):
            yield from (index for _, index in ranked if texts[index] == winner)


def make_text_column(
    title: str, write: Callable[[Row], Any], *, wrap_em: float | None = None, note: str = ""
) -> Column:
    """Make a column of words, a dash where ``write`` gives nothing."""

    def write_cell(row: Row) -> Cell:
        text = write(row)
        return Cell(DASH if _is_missing(text) or text == "" else str(text))

    return Column(title, write_cell, wrap_em=wrap_em, is_number=False, note=note)


def make_number_column(
    key: str,
    title: str,
    below: str = "",
    *,
    scale: float = 1.0,
    best: Literal["lowest", "highest"] | None = None,
    over: str = "",
    digits: int = 3,
    least: float = 0.0,
    note: str = "",
) -> Column:
    """Make a column of the numbers under ``key``, times ``scale``.

    A value with bounds under ``key_low`` and ``key_high`` has the digits that these decide, others have
    ``digits``; below ``least`` only that is told. A mark is read from ``key_mark``.
    """

    def write(row: Row) -> Cell:
        value: Any = row.get(key)
        low, high = row.get(f"{key}_low"), row.get(f"{key}_high")
        if not _is_missing(value) and abs(scale * value) < least:
            cell = Cell(f"< {least:g}")
        else:
            cell = write_number(value, low, high, scale=scale, digits=digits)
        mark = row.get(f"{key}_mark")
        return cell._replace(mark=mark) if isinstance(mark, str) else cell

    def rank(row: Row) -> float | None:
        value: Any = row.get(key)
        return None if _is_missing(value) else float(value) * (-1.0 if best == "highest" else 1.0)

    return Column(title, write, below, over, rank if best else None, note=note)


def make_count_column(key: str, title: str, *, note: str = "") -> Column:
    """Make a column of whole numbers."""

    def write(row: Row) -> Cell:
        value: Any = row.get(key)
        return Cell(DASH if _is_missing(value) else f"{value:.0f}")

    return Column(title, write, note=note)


def write_number(
    value: Any, low: Any = None, high: Any = None, *, scale: float = 1.0, digits: int = 3
) -> Cell:
    """Write a number with its interval, where there is one; a dash where nothing was measured."""
    if _is_missing(value):
        return Cell(DASH)
    if _is_missing(low) or _is_missing(high):
        return Cell(format_number(scale * value, digits=digits))
    bounds = (scale * value, scale * low, scale * high)
    text, lower, upper = format_interval(*bounds, most_digits=MOST_DIGITS)
    return Cell(text, f"[{lower}, {upper}]")


def _is_missing(value: Any) -> bool:
    return value is None or (isinstance(value, float) and value != value)


def write_tables(output: Any, frame: pd.DataFrame, tables: Sequence[PrintedTable]) -> None:
    """Write every form of a table to the paths of ``output``.

    ``csv`` has all of ``frame``, ``tex`` the first table, ``appendix`` the others, and ``html`` all of them.
    """
    write_text(output.csv, frame.to_csv(index=False))
    write_text(output.tex, format_latex(tables[0]))
    if len(tables) > 1:
        write_text(output.appendix, "\n".join(format_latex(table) for table in tables[1:]))
    write_text(output.html, format_html(tables))


def format_latex(table: PrintedTable) -> str:
    """Format a table for ``\\input`` in any two-column article, as floats over both columns.

    A table that is too high for a page goes on in a further float. Without rows the text is a comment.
    """
    parts = _split(table.blocks)
    if not parts:
        return f"% {table.lead} Nothing was measured.\n"
    floats = []
    for number, blocks in enumerate(parts, start=1):
        lead = table.lead if number == 1 else f"{table.lead.removesuffix('.')}, continued."
        label = table.label if number == 1 else f"{table.label}-{number}"
        floats.append(_format_float(table, blocks, lead=lead, label=label, is_first=number == 1))
    return "\n".join(floats)


def _format_float(
    table: PrintedTable,
    blocks: Iterable[tuple[str, list[list[Cell]]]],
    *,
    lead: str,
    label: str,
    is_first: bool,
) -> str:
    caption = rf"\textbf{{{escape_latex(lead)}}}" + (f" {escape_latex(table.caption)}" if is_first else "")
    body = []
    for title, rows in blocks:
        heading = rf"\multicolumn{{{len(table.columns)}}}{{@{{}}l}}{{\emph{{{escape_latex(title)}}}}} \\"
        body += [r"\midrule", *([heading] if title else [])]
        body += [_join([_cell_latex(*pair) for pair in zip(row, table.columns, strict=True)]) for row in rows]
    size, gap_pt = "footnotesize", 3.5
    if _estimate_width_pt(table, gap_pt) > TEXT_WIDTH_PT:
        size, gap_pt = "scriptsize", 2.5
    notes = escape_latex(" ".join(table.notes)) if is_first else ""
    below = [rf"\par\vspace{{3pt}}\parbox{{\textwidth}}{{\scriptsize\raggedright {notes}}}"] if notes else []
    return "\n".join(
        [
            BOOKTABS_FALLBACK,
            r"\begin{table*}",
            rf"\centering\{size}\setlength{{\tabcolsep}}{{{gap_pt}pt}}",
            rf"\caption{{{caption}}}",
            rf"\label{{{label}}}\par\vspace{{3pt}}",
            rf"\begin{{tabular}}{{@{{}}{''.join(map(_alignment, table.columns))}@{{}}}}",
            r"\toprule",
            *_head_latex(table.columns),
            *body,
            r"\bottomrule",
            r"\end{tabular}",
            *below,
            r"\end{table*}",
            "",
        ]
    )


def _estimate_width_pt(table: PrintedTable, gap_pt: float) -> float:
    """Width of a table at ``\\footnotesize``, from the characters of its cells and headings."""
    width_pt = 2.0 * gap_pt * (len(table.columns) - 1)
    for place, column in enumerate(table.columns):
        if column.wrap_em is not None:
            width_pt += 2.0 * DIGIT_PT * column.wrap_em
            continue
        cells = [row[place] for _, rows in table.blocks for row in rows]
        widths = [
            _count_digits(cell.text) + SMALLER * _count_digits(cell.small + cell.mark) for cell in cells
        ]
        width_pt += DIGIT_PT * max(_count_digits(column.title), _count_digits(column.below), *widths)
    return width_pt


def _count_digits(text: str) -> float:
    """Width of a text in digits."""
    return sum(0.5 if character in NARROW else 1.0 for character in text)


def _split(blocks: Blocks) -> list[list[tuple[str, list[list[Cell]]]]]:
    """Blocks for each float; one that is higher than a float goes on in the next."""
    parts: list[list[tuple[str, list[list[Cell]]]]] = []
    lines = MOST_LINES
    for title, rows in blocks:
        for start in range(0, len(rows), MOST_LINES - 1):
            chunk = rows[start : start + MOST_LINES - 1]
            if lines + len(chunk) + 1 > MOST_LINES:
                parts.append([])
                lines = 0
            parts[-1].append((title, chunk))
            lines += len(chunk) + 1
    return parts


def _head_latex(columns: Sequence[Column]) -> list[str]:
    lines = []
    if any(column.over for column in columns):
        spans = [rf"\multicolumn{{{n}}}{{c}}{{{escape_latex(over)}}}" for over, n in _list_spans(columns)]
        lines.append(_join(spans) + _list_rules(columns))
    lines.append(_join([escape_latex(column.title) for column in columns]))
    if any(column.below for column in columns):
        lines.append(_join([escape_latex(column.below) for column in columns]))
    return lines


def _list_rules(columns: Sequence[Column]) -> str:
    """Rules below the headings that columns share."""
    rules, first = "", 1
    for over, n in _list_spans(columns):
        rules += rf" \cline{{{first}-{first + n - 1}}}" if over else ""
        first += n
    return rules


def _list_spans(columns: Sequence[Column]) -> list[tuple[str, int]]:
    """Shared headings with the number of columns below each; columns without one stand alone."""
    spans: list[tuple[str, int]] = []
    for column in columns:
        if spans and column.over and spans[-1][0] == column.over:
            spans[-1] = (column.over, spans[-1][1] + 1)
        else:
            spans.append((column.over, 1))
    return spans


def _alignment(column: Column) -> str:
    if column.wrap_em is not None:
        return f"p{{{column.wrap_em}em}}"
    return "c" if column.is_number else "l"


def _cell_latex(cell: Cell, column: Column) -> str:
    text = escape_latex(cell.text)
    if cell.bold:
        text = rf"\textbf{{{text}}}"
    if cell.italic:
        text = rf"\emph{{{text}}}"
    if cell.mark:
        text += rf"\textsuperscript{{{escape_latex(cell.mark)}}}"
    if cell.small:
        text += rf"\,{{\scriptsize {escape_latex(cell.small)}}}"
    return rf"\raggedright {text}" if column.wrap_em is not None else text


def _join(texts: Sequence[str]) -> str:
    return " & ".join(texts) + r" \\"


def format_markdown(table: PrintedTable) -> str:
    """Format the rows of a table for a page in Markdown, blocks below each other, then caption and notes."""
    headings = [f"{column.over} {column.title} {column.below}".strip() for column in table.columns]
    rules = [":-:" if column.is_number else "---" for column in table.columns]
    lines = [_join_markdown(headings), _join_markdown(rules)]
    for title, rows in table.blocks:
        lines += [_join_markdown([f"*{title}*", *[""] * (len(headings) - 1)])] if title else []
        lines += [_join_markdown(map(_cell_markdown, row)) for row in rows]
    return "\n".join([*lines, "", " ".join([table.caption, *table.notes]).strip()])


def _cell_markdown(cell: Cell) -> str:
    mark = "**" if cell.bold else "*" if cell.italic else ""
    raised = f"<sup>{cell.mark}</sup>" if cell.mark else ""
    return " ".join(filter(None, [f"{mark}{cell.text}{mark}{raised}", cell.small]))


def _join_markdown(texts: Iterable[str]) -> str:
    cells = (text.replace("|", r"\|") for text in texts)
    return f"| {' | '.join(cells)} |"


def format_html(tables: Sequence[PrintedTable]) -> str:
    """Format tables as one page that needs no other file, in light or dark as the reader's device asks."""
    loader = PackageLoader("lagsplat.report.common")
    settings: dict[str, Any] = {"trim_blocks": True, "lstrip_blocks": True, "undefined": StrictUndefined}
    environment = Environment(loader=loader, autoescape=True, **settings)
    environment.filters["spans"] = _list_spans
    return environment.get_template("tables.html.j2").render(tables=tables)
