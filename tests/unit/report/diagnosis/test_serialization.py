"""What is written is read back, follows the format, and breaks loudly where it does not."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from lagsplat.diagnose.core.result import Block
from lagsplat.report.diagnosis.content import (
    build_rollouts_table,
    save_next_inputs,
    save_rollouts,
    to_plain_data,
)
from lagsplat.report.diagnosis.serialization import (
    build_diagnosis_content,
    check_diagnosis,
    load_diagnosis,
    save_diagnosis,
)
from tests.unit.report.diagnosis import made_diagnoses

KINDS = made_diagnoses.every_kind()
KEYS = {"schema", "verdict", "effects", "combination", "where", "gap", "equivalent", "excitation", "warnings"}


@pytest.mark.parametrize("kind", KINDS)
def test_a_diagnosis_comes_back(kind, tmp_path):
    made = KINDS[kind]
    save_diagnosis(tmp_path / "diagnosis.json", made)
    read = load_diagnosis(tmp_path / "diagnosis.json")
    for name in (
        "verdict",
        "combination",
        "gap",
        "equivalent",
        "excitation",
        "warnings",
        "q_names",
    ):
        assert getattr(read, name) == getattr(made, name)
    assert [one.name for one in read.candidates] == [one.name for one in made.candidates]
    assert [one.closure for one in read.candidates] == [one.closure for one in made.candidates]
    # A second saving changes nothing.
    save_diagnosis(tmp_path / "again.json", read)
    assert (tmp_path / "again.json").read_bytes() == (tmp_path / "diagnosis.json").read_bytes()


def test_the_file_has_the_promised_keys(tmp_path):
    save_diagnosis(tmp_path / "diagnosis.json", KINDS["single"])
    content = json.loads((tmp_path / "diagnosis.json").read_text())
    assert set(content) >= KEYS
    assert content["schema"] == 1
    first = content["effects"][0]
    assert set(first) >= {"name", "probability", "coordinate", "input", "parameters", "closure"}
    assert set(first["parameters"]["acceleration"]) == {"value", "low", "high", "unit"}
    assert set(first["closure"]) == {"value", "low", "high"}
    assert content["gap"]["unit"] == "fraction of each coordinate's rms"
    assert content["where"]["time_s"][0] == ["swing.csv", 1.0, 4.5, 0.4]
    assert sum(one["probability"] for one in content["effects"]) == pytest.approx(1.0)


def test_what_is_missing_is_named():
    where = build_diagnosis_content(KINDS["undetermined"])["where"]
    assert set(where["not_computed"]) >= {"level", "coordinates", "time_s", "state_region"}
    assert build_diagnosis_content(KINDS["single"])["where"]["not_computed"] == []
    without_pictures = build_diagnosis_content(KINDS["push"])["where"]["not_computed"]
    assert set(without_pictures) == {"time_s", "frequency_hz", "state_region", "image_region", "components"}


def break_with(change):
    content = build_diagnosis_content(KINDS["single"])
    change(content)
    return content


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda c: c["effects"][0].update(probability=0.5), "sum to"),
        (lambda c: c["effects"].reverse(), "order"),
        (lambda c: c["effects"][0].update(name="magnetism"), "effects/0/name"),
        (lambda c: c.pop("gap"), "gap"),
        (lambda c: c.update(verdict="maybe"), "verdict"),
        (lambda c: c["where"].update(level="soul"), "where/level"),
        (lambda c: c["where"]["time_s"].append(["a.csv", 1.0]), "where/time_s"),
        (lambda c: c.update(combination=["end_stop"]), "end_stop"),
        (lambda c: c["effects"][0]["parameters"]["acceleration"].pop("unit"), "unit"),
        (lambda c: c["equivalent"].append(["coulomb_friction"]), "equivalent"),
    ],
)
def test_a_broken_diagnosis_is_refused(change, told):
    check_diagnosis(build_diagnosis_content(KINDS["single"]))
    with pytest.raises(ValueError, match=told):
        check_diagnosis(break_with(change))


def test_none_and_unknown_are_always_there():
    made = KINDS["single"]
    without = tuple(replace(one, name="creep") if one.name == "none" else one for one in made.candidates)
    with pytest.raises(ValueError, match="`none` is missing"):
        check_diagnosis(build_diagnosis_content(replace(made, candidates=without)))


def test_nothing_is_written_where_it_is_refused(tmp_path):
    made = KINDS["single"]
    wrong = tuple(replace(one, probability=0.1) for one in made.candidates)
    with pytest.raises(ValueError, match="sum to"):
        save_diagnosis(tmp_path / "diagnosis.json", replace(made, candidates=wrong))
    assert list(tmp_path.iterdir()) == []


def test_reading_a_file_that_is_none(tmp_path):
    (tmp_path / "a.json").write_text("{")
    with pytest.raises(ValueError, match=r"a\.json is not JSON"):
        load_diagnosis(tmp_path / "a.json")
    (tmp_path / "b.json").write_text("{}")
    with pytest.raises(ValueError, match=r"b\.json: not a diagnosis"):
        load_diagnosis(tmp_path / "b.json")


def test_plain_data():
    made = to_plain_data(
        {"a": np.float32(0.5), "b": np.array([1.0, np.nan]), "c": (1, float("inf")), 3: {"y", "x"}}
    )
    assert made == {"a": 0.5, "b": [1.0, None], "c": [1, None], "3": ["x", "y"]}
    with pytest.raises(TypeError, match="no place in JSON"):
        to_plain_data(object())


def test_rollouts_come_back_to_the_last_bit(tmp_path):
    rng = np.random.default_rng(2)
    blocks = made_diagnoses.blocks()
    odd = Block('a "b",c.csv', 7, np.sort(rng.random(5)) / 3, *rng.standard_normal((3, 5, 2)) / 7)
    hole = replace(odd, index=8, sim=np.full((5, 2), np.nan))
    save_rollouts(tmp_path / "rollouts.csv", (*blocks, odd, hole), q_names=("q0", "q1"))
    parts = pd.read_csv(tmp_path / "rollouts.csv").groupby(["file", "block"], sort=False)
    for block, (place, table) in zip((*blocks, odd, hole), parts, strict=True):
        assert (block.file, block.index) == place
        np.testing.assert_array_equal(block.time_s, table["t"])
        for name in ("real", "sim", "augmented"):
            np.testing.assert_array_equal(getattr(block, name), table[[f"q0_{name}", f"q1_{name}"]])


def test_the_gap_can_be_computed_again_from_the_file(tmp_path):
    made = KINDS["single"]
    save_rollouts(tmp_path / "rollouts.csv", made.blocks, q_names=made.q_names)
    table = pd.read_csv(tmp_path / "rollouts.csv")
    assert list(table.columns) == [
        "file",
        "block",
        "t",
        "q0_real",
        "q1_real",
        "q0_sim",
        "q1_sim",
        "q0_augmented",
        "q1_augmented",
    ]
    scale = table[["q0_real", "q1_real"]].std(ddof=0).to_numpy()
    for kind, told in (("sim", made.gap.before), ("augmented", made.gap.after)):
        off = table[[f"q0_{kind}", f"q1_{kind}"]].to_numpy() - table[["q0_real", "q1_real"]].to_numpy()
        assert np.sqrt(np.mean((off / scale) ** 2)) == pytest.approx(told)


def test_rollouts_have_as_many_columns_as_coordinates():
    with pytest.raises(ValueError, match="coordinates"):
        build_rollouts_table(made_diagnoses.blocks(), q_names=("q0",))
    assert list(build_rollouts_table(()).columns) == [
        "file",
        "block",
        "t",
        "q0_real",
        "q0_sim",
        "q0_augmented",
    ]


def test_files_and_next_experiments_come_back_without_their_tables(tmp_path):
    files, planned = made_diagnoses.several_files(), made_diagnoses.planned()
    made = replace(KINDS["single"], files=files, next_experiments=planned)
    save_diagnosis(tmp_path / "diagnosis.json", made)
    read = load_diagnosis(tmp_path / "diagnosis.json")
    assert read.files == files
    assert read.next_experiments.between == planned.between
    bare = tuple(replace(each, input={}) for each in planned.suggestions)
    assert read.next_experiments.suggestions == bare


def test_inputs_to_play_are_tables_that_replace_older_ones(tmp_path):
    made = replace(KINDS["single"], next_experiments=made_diagnoses.planned())
    (tmp_path / "next_experiment_3.csv").write_text("old")
    save_next_inputs(tmp_path, made)
    assert [path.name for path in tmp_path.iterdir()] == ["next_experiment_1.csv"]
    table = pd.read_csv(tmp_path / "next_experiment_1.csv")
    assert list(table.columns) == ["t", "torque"]
    assert table["torque"].tolist() == [0.0, 0.5, 1.0]
    save_next_inputs(tmp_path, KINDS["single"])
    assert not list(tmp_path.iterdir())
