"""The table of the README takes its numbers from the published files."""

import pandas as pd
import pytest

from benchmarks import published_summary, published_tables


def test_a_range_is_one_number_where_both_ends_read_alike() -> None:
    assert published_summary.write_range(pd.Series([0.001, 0.0042]), 100, " %") == "0.1 to 0.42 %"
    assert published_summary.write_range(pd.Series([0.2, 0.2])) == "0.2"


def test_rows_are_found_by_their_values_or_missed_by_name() -> None:
    rows = published_tables.read_rows("quick_filmed_four/physical", system=("pendulum_pair", "building_sway"))
    assert list(rows["system"]) == ["pendulum_pair", "building_sway"]
    with pytest.raises(ValueError, match=r"physical\.csv has no row with .*'moon'"):
        published_tables.read_rows("quick_filmed_four/physical", system="moon")


def test_films_and_diagnosis_are_told_as_their_files_have_them() -> None:
    errors = published_tables.read_rows("quick_filmed_four/physical")["frequency_error"]
    (films,) = published_summary.summarize_films()
    assert f"{100 * errors.max():.2g} %" in films.found
    found = published_tables.read_rows("gap_blind/blind-7/gap_blind", metric="top-1, class")["diagnosis"]
    first, *_ = published_summary.summarize_diagnosis()
    assert first.found.endswith(found.iloc[0].replace(" n=", " of "))
    assert not first.met


def test_what_misses_its_aim_is_bold(monkeypatch, capsys) -> None:
    rows = [
        published_summary.Measure("one", "3 %", "2 %", met=False),
        published_summary.Measure("other", "1 %", "2 %"),
    ]
    monkeypatch.setattr(published_summary, "PAGES", {"systems": lambda: iter(rows)})
    published_summary.show_summary()
    lines = capsys.readouterr().out.splitlines()[3:5]
    assert [line.split(" | ")[2] for line in lines] == ["**3 %**", "1 %"]
