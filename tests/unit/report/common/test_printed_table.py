"""What is bold, where digits end, when a dash is explained, and how a long table goes on."""

import pandas as pd

from lagsplat.report.common.formatting import escape_latex
from lagsplat.report.common.printed_table import (
    MOST_LINES,
    PrintedTable,
    format_html,
    format_latex,
    lay_out,
    make_number_column,
    make_text_column,
    write_number,
)


def laid_out(**columns: list) -> PrintedTable:
    frame = pd.DataFrame({"system": "arm", "recording": "simulated", **columns}, dtype=object)
    return lay_out(
        frame,
        [
            make_text_column("Method", lambda row: row["method"]),
            make_number_column("error", "Error", "(%)", scale=100.0, best="lowest", note="Error: of all."),
            make_number_column("score", "Score", best="highest"),
        ],
        label="tab:x",
        lead="Lead.",
        caption="Rest.",
        block=lambda row: row["recording"],
    )


def test_the_best_is_bold_within_one_recording() -> None:
    table = laid_out(
        method=["a", "b", "c", "d"],
        recording=["simulated", "simulated", "filmed", "filmed"],
        error=[0.2, 0.1, 0.01, None],
        score=[1.0, 2.0, 3.0, 3.0],
    )
    bold = [[cell.bold for cell in row] for _, rows in table.blocks for row in rows]
    assert bold == [[False, False, False], [False, True, True], [False] * 3, [False] * 3]
    assert table.notes[0] == "Error: of all."
    assert [note.split(":")[0] for note in table.notes] == ["Error", "Bold", "A dash"]


def test_a_column_without_a_value_is_left_out_with_its_note() -> None:
    table = laid_out(method=["a", "b"], error=[None, float("nan")], score=[1.0, 1.0])
    assert [column.title for column in table.columns] == ["Method", "Score"]
    assert table.notes == []


def test_digits_follow_the_interval() -> None:
    assert write_number(0.0777, 0.0775, 0.0879, scale=1e2)[:2] == ("7.8", "[7.8, 8.8]")
    assert write_number(1.0000009, 0.99996, 1.00005)[:2] == ("1.000", "[1.000, 1.000]")
    assert write_number(195e3).text == "195000"
    assert write_number(None).text == "–"


def test_text_is_escaped_and_powers_are_raised() -> None:
    assert escape_latex("a_1 & 10⁻¹⁶ < 2 °") == r"a\_1 \& 10$^{-16}$ $<$ 2 $^\circ$"
    page = format_html([laid_out(method=["<b>", "c"], error=[1.0, 2.0], score=[1.0, 2.0])])
    assert "&lt;b&gt;" in page
    assert "<b>100</b>" in page


def test_a_table_higher_than_a_page_goes_on_in_another() -> None:
    n = 2 * MOST_LINES
    table = laid_out(method=[f"m{k}" for k in range(n)], error=[0.1] * n, score=[float(k) for k in range(n)])
    text = format_latex(table)
    assert text.count(r"\begin{table*}") == 3
    assert text.count("Lead, continued.") == 2
    assert text.count("Error: of all.") == 1
    assert all(f"m{k} &" in text for k in range(n))
    assert "measured" in format_latex(table._replace(blocks=[]))
