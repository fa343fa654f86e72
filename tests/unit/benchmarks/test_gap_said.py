"""What a method may say, and recordings that are none."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from benchmarks.gap_baselines.case import open_case
from benchmarks.gap_baselines.contest import choose_by_error
from benchmarks.gap_baselines.predict import main, method_of
from benchmarks.gap_baselines.said import APART, Said, diagnosis, names, weigh, write
from benchmarks.gapgen.predictions import read_prediction
from tests.unit.benchmarks.cases import move, recording


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording without a change."""
    place = tmp_path_factory.mktemp("cases")
    recording(place / "none", move())
    return place


def chance(folder: Path, out: Path) -> list[str]:
    main(["--method", "chance", "--out", str(out), str(folder)])
    found = json.loads((out / folder.name / "diagnosis.json").read_text(encoding="utf-8"))
    return [effect["name"] for effect in found["effects"]]


def test_chance_depends_on_the_content_and_has_no_favourites(folder: Path, tmp_path: Path) -> None:
    first = set()
    lines = (folder / "none" / "real_0.csv").read_text().splitlines(keepends=True)
    for k in range(12):
        for name in (f"{k}", f"renamed {k}"):
            shutil.copytree(folder / "none", tmp_path / name)
            (tmp_path / name / "real_0.csv").write_text("".join(lines[: 100 + k]))
        said = chance(tmp_path / f"{k}", tmp_path / "out")
        assert chance(tmp_path / f"renamed {k}", tmp_path / "out") == said
        first.add(said[0])
    assert len(first) > 5


def test_a_case_has_both_sides(folder: Path) -> None:
    case = open_case(folder / "none")
    assert (case.d, len(case.sim), len(case.real)) == (1, 1, 1)
    assert np.array_equal(case.real[0].q, open_case(folder / "none").real[0].q)


def test_what_is_said_is_read_as_it_was_meant(tmp_path: Path) -> None:
    said = Said({"creep": 0.25, "none": 0.75}, "q1", None, {"time_constant": (1.0, 0.5, 2.0)})
    write(said, tmp_path)
    found = read_prediction(tmp_path, [1.0])
    assert (found.verdict, found.ranking[:2]) == ("none", ("none", "creep"))
    assert set(found.probability) == {*names(), *APART}
    assert found.combination == ()
    write(Said({"creep": 1.0}, "q1", None, {"time_constant": (1.0, 0.5, 2.0)}), tmp_path)
    found = read_prediction(tmp_path, [1.0])
    assert (found.verdict, found.combination) == ("effect", ("creep",))
    assert found.where["coordinates"] == {"q1": 1.0}
    assert found.candidates["creep"]["parameters"]["time_constant"]["low"] == 0.5


def test_a_recording_that_is_not_one_is_passed_over(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    main(
        ["--method", "chance", "--out", str(tmp_path / "out"), str(tmp_path / "empty"), str(folder / "none")]
    )
    assert "needs sim_*.csv" in (tmp_path / "out" / "empty" / "failed.txt").read_text()
    assert (tmp_path / "out" / "none" / "diagnosis.json").is_file()


def test_names_beside_the_first_are_a_set(tmp_path: Path) -> None:
    write(Said({"creep": 0.7, "end_stop": 0.3}, "q0", others=("end_stop",)), tmp_path)
    assert read_prediction(tmp_path, [1.0]).combination == ("creep", "end_stop")


def test_what_a_method_chose_weighs_no_less_than_the_rest() -> None:
    weights = weigh({"none": -2.0, "creep": 0.0, "end_stop": -1.0}, "none")
    assert sum(weights.values()) == pytest.approx(1.0)
    assert Said(weights).first == "none"
    assert weights["none"] == weights["creep"] > weights["end_stop"]


@pytest.mark.parametrize(
    ("creep", "first"), [([0.1, 0.12, 0.08], "creep"), ([0.4, 1.9, 0.3], "none"), ([2.0, 2.0, 2.0], "none")]
)
def test_a_name_must_err_clearly_less_than_none(creep: list[float], first: str) -> None:
    squares = {"none": np.array([0.9, 1.0, 1.1]), "creep": np.array(creep)}
    found, scores = choose_by_error(squares)
    assert found == first
    assert max(scores.values()) == 0.0


def test_equals_keep_the_order_in_which_they_are_said() -> None:
    found = diagnosis(Said({"creep": 0.5, "none": 0.5}))
    assert (found.verdict, found.candidates[0].name) == ("effect", "creep")
    assert diagnosis(Said({"none": 1.0})).combination == ()


def test_an_unknown_method_is_refused() -> None:
    with pytest.raises(ValueError, match="choose from"):
        method_of("guess")
