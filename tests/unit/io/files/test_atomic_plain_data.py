"""CSV and JSON for people: round trips, and files that cannot be used."""

from pathlib import Path

import pytest

from lagsplat.io.files.atomic import load_json, save_csv, save_json


def test_json_comes_back(tmp_path: Path) -> None:
    content = {"name": "toy", "scores": [1.5, None], "nested": {"n": 3}}
    save_json(tmp_path / "a.json", content)
    assert load_json(tmp_path / "a.json") == content


def test_broken_json_names_the_file(tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text("{", encoding="utf-8")
    with pytest.raises(ValueError, match=r"a\.json: not JSON"):
        load_json(tmp_path / "a.json")


def test_missing_values_are_empty_cells(tmp_path: Path) -> None:
    save_csv(tmp_path / "a.csv", [{"step": 1, "loss": 0.5}, {"step": 2, "loss": None}])
    assert (tmp_path / "a.csv").read_text(encoding="utf-8") == "step,loss\n1,0.5\n2,\n"


def test_a_table_needs_a_row_and_one_set_of_columns(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="without a row"):
        save_csv(tmp_path / "a.csv", [])
    with pytest.raises(ValueError, match="extra"):
        save_csv(tmp_path / "a.csv", [{"a": 1}, {"a": 1, "extra": 2}])
    assert not (tmp_path / "a.csv").exists()
