"""CSV and JSON for people: round trips, and files that cannot be used."""

from pathlib import Path

import numpy as np
import pytest

from lagsplat.io.files.atomic import load_inputs, load_json, save_csv, save_json


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


def test_inputs_are_interpolated_between_rows(tmp_path: Path) -> None:
    (tmp_path / "u.csv").write_text("t,u0,u1\n0,0,1\n1,1,1\n3,5,1\n", encoding="utf-8")
    time_s, inputs = load_inputs(tmp_path / "u.csv", dt_s=0.5)
    np.testing.assert_allclose(time_s, 0.5 * np.arange(7))
    np.testing.assert_allclose(inputs[:, 0], [0, 0.5, 1, 2, 3, 4, 5])
    np.testing.assert_allclose(inputs[:, 1], 1)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "t,u0\n",
        "t,u0\n0,1\n",
        "t,u1\n0,1\n1,1\n",
        "t,u0\n0,a\n1,1\n",
        "t,u0\n1,1\n1,2\n",
        "t,u0\n0,nan\n1,2\n",
    ],
)
def test_unusable_inputs_name_the_file(tmp_path: Path, text: str) -> None:
    (tmp_path / "u.csv").write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=r"u\.csv"):
        load_inputs(tmp_path / "u.csv", dt_s=0.1)
