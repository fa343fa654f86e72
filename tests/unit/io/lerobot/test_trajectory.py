"""States and actions of LeRobot's own files, their units, and what is refused with its place."""

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from lagsplat.io.lerobot.dataset import is_lerobot, open_dataset
from lagsplat.io.lerobot.units import decide_unit
from lagsplat.io.read import read_trajectory
from tests.unit.io.lerobot.datasets import NAMES, block, change_info, rewrite, rows_of, scale, set_column


def test_states_are_coordinates_and_actions_inputs(dataset: Path) -> None:
    with pytest.warns(UserWarning, match="converted from degrees to radians.*gripper.pos.* kept as written"):
        motion = read_trajectory(dataset)
    rows = rows_of(dataset)
    angle, opening = np.deg2rad(block(rows, "observation.state")), block(rows, "observation.state")[:, -1]
    np.testing.assert_allclose(motion.q[:, :-1], angle[:, :-1])
    np.testing.assert_allclose(motion.q[:, -1], opening)
    np.testing.assert_allclose(motion.u[:, :-1], np.deg2rad(block(rows, "action"))[:, :-1])
    assert motion.q_names == NAMES
    assert motion.u_names == tuple(f"{name}_target" for name in NAMES)
    assert motion.segments == ((0, 60), (60, 105))
    assert motion.dt_s == pytest.approx(1 / 30)
    np.testing.assert_array_equal(motion.time_s[:60], np.arange(60) / 30)
    assert motion.time_s[60] - motion.time_s[59] == pytest.approx(1.0)


@pytest.mark.filterwarnings("ignore:v..")
def test_columns_choose_joints_by_short_or_whole_names(dataset: Path) -> None:
    columns = {"q0": "elbow_flex.pos", "q1": "observation.state.shoulder_pan.pos", "u0": "elbow_flex.pos"}
    chosen, whole = read_trajectory(dataset, columns=columns), read_trajectory(dataset)
    np.testing.assert_array_equal(chosen.q, whole.q[:, [2, 0]])
    np.testing.assert_array_equal(chosen.u, whole.u[:, [2]])
    assert (chosen.q_names, chosen.u_names) == (("q0", "q1"), ("u0",))
    with pytest.raises(ValueError, match=r"no number 'observation.state.elbow' .*elbow_flex.pos"):
        read_trajectory(dataset, columns={"q0": "elbow"})


def test_a_unit_that_cannot_be_told_is_asked_for(dataset: Path) -> None:
    scale(dataset, 0.5)
    with pytest.raises(ValueError, match=r"no unit of the joints.*no state exceeds 59\.\d+. Give joint_unit"):
        read_trajectory(dataset)
    with pytest.warns(UserWarning, match=r"kept as written: joint_unit=as_written says so"):
        kept = read_trajectory(dataset, joint_unit="as_written")
    with pytest.warns(UserWarning, match="converted from degrees"):
        turned = read_trajectory(dataset, joint_unit="degree")
    np.testing.assert_allclose(np.deg2rad(kept.q[:, :-1]), turned.q[:, :-1])
    with pytest.raises(ValueError, match="joint_unit=turns must be one of degree, radian, as_written"):
        read_trajectory(dataset, joint_unit="turns")


@pytest.mark.parametrize(
    ("robot", "largest", "unit"),
    [
        ("so100", 3.0, "degree"),
        ("so101_follower", 100.2, ""),
        ("so101_follower", 101.0, "degree"),
        ("panda", 3.0, "radian"),
        ("panda", 30.0, ""),
        (None, 1.0, "radian"),
    ],
)
def test_the_rule_of_units(v30: Path, robot: str | None, largest: float, unit: str) -> None:
    change_info(v30, lambda info: info.update(robot_type=robot))
    states = {
        "observation.state.a.pos": np.array([0.0, -largest]),
        "observation.state.gripper.pos": 99 * np.ones(2),
    }
    assert decide_unit(open_dataset(v30), states, setting=None).name == unit
    assert decide_unit(open_dataset(v30), states, setting="radian").name == "radian"


@pytest.mark.filterwarnings("ignore:v30. joints")
def test_rates_and_torques_are_no_coordinates(v30: Path) -> None:
    parts = ["a.pos", "a.vel", "a.torque", "b.pos", "b.vel", "gripper.pos"]
    change_info(v30, lambda info: info["features"]["observation.state"].update(names=parts))
    motion = read_trajectory(v30, joint_unit="radian")
    assert motion.q_names == ("a.pos", "b.pos", "gripper.pos")
    columns = {"q0": "a.pos", "v0": "a.vel", "u0": "observation.state.a.torque"}
    motion = read_trajectory(v30, columns=columns, joint_unit="degree")
    raw = block(rows_of(v30), "observation.state")
    np.testing.assert_allclose(motion.q[:, 0], np.deg2rad(raw[:, 0]))
    np.testing.assert_allclose(motion.u[:, 0], raw[:, 2])


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        ({"motors": list("abcdef")}, tuple("abcdef")),
        ({name: place for place, name in enumerate("fedcba")}, tuple("fedcba")),
        (None, tuple("012345")),
        (["state"], tuple("012345")),
    ],
)
def test_names_in_every_form_that_datasets_have(v21: Path, names: Any, expected: tuple[str, ...]) -> None:
    change_info(v21, lambda info: info["features"]["action"].update(names=names))
    assert open_dataset(v21).features["action"].parts == expected


def test_what_is_missing_is_named(dataset: Path) -> None:
    (dataset / "meta/info.json").rename(dataset / "meta/info.old")
    assert is_lerobot(dataset)
    with pytest.raises(FileNotFoundError, match=r"meta/info\.json: missing, and nothing else tells version"):
        read_trajectory(dataset)
    (dataset / "meta/info.old").rename(dataset / "meta/info.json")
    for file in list(dataset.glob("data/*/*.parquet"))[-1:]:
        content = file.read_bytes()
        file.write_bytes(content[: len(content) // 2])
        with pytest.raises(ValueError, match=rf"{file.name}: truncated or no Parquet file .*again"):
            read_trajectory(dataset)
        file.unlink()
        with pytest.raises(FileNotFoundError, match=rf"{file.name}: missing, though the metadata"):
            read_trajectory(dataset)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda info: info.update(codebase_version="v1.6"),
            r"'v1.6'; versions 2.1 and 3.0 are read. Convert",
        ),
        (lambda info: info.update(codebase_version="v4.0"), r"'v4.0'; versions 2.1 and 3.0 are read"),
        (lambda info: info.pop("features"), "without features"),
        (lambda info: info.update(fps=0), "fps 0; it must be a rate above 0"),
        (lambda info: info.update(total_episodes=3), "announces 3 episodes, but .* lists 2"),
        (lambda info: info["features"].update(action={"dtype": "float32"}), "feature 'action' is"),
        (
            lambda info: info.update(data_path="../{episode_index}{chunk_index}"),
            "cannot be filled|none inside",
        ),
        (lambda info: info.update(data_path="/etc/passwd"), "'/etc/passwd' is none inside the dataset"),
        (lambda info: info.update(data_path="{x.__class__}"), "cannot be filled"),
        (lambda info: info["features"]["action"].update(shape=[7]), r"6 numbers in 'action', but .* \[7\]"),
        (lambda info: info["features"].pop("observation.state"), "no feature 'observation.state' of numbers"),
    ],
)
def test_metadata_that_cannot_be_used(dataset: Path, change: Callable[[dict], object], message: str) -> None:
    change_info(dataset, change)
    with pytest.raises(ValueError, match=message):
        read_trajectory(dataset)


def test_damaged_json(dataset: Path) -> None:
    (dataset / "meta/info.json").write_text("{")
    with pytest.raises(ValueError, match=r"info\.json: damaged, no JSON"):
        read_trajectory(dataset)


def test_episodes_out_of_order_or_missing(v21: Path, v30: Path) -> None:
    lines = (v21 / "meta/episodes.jsonl").read_text().splitlines()
    (v21 / "meta/episodes.jsonl").write_text("\n".join(reversed(lines)))
    with pytest.raises(ValueError, match=r"episodes.jsonl, line 1: episode 1 where episode 0 should stand"):
        read_trajectory(v21)
    (v21 / "meta/episodes.jsonl").write_text(f"{lines[0]}\n{{")
    with pytest.raises(ValueError, match=r"episodes.jsonl, line 2: no episode_index and length"):
        read_trajectory(v21)
    (v21 / "meta/episodes.jsonl").unlink()
    with pytest.raises(FileNotFoundError, match=r"episodes.jsonl: missing"):
        read_trajectory(v21)
    file = v30 / "meta/episodes/chunk-000/file-000.parquet"
    rewrite(file, lambda table: set_column(table, "episode_index", pa.array([0, 2])))
    with pytest.raises(ValueError, match=r"file-000.parquet, row 1: episode 2 where episode 1 should stand"):
        read_trajectory(v30)
    file.unlink()
    with pytest.raises(FileNotFoundError, match=r"no chunk-000/file-000.parquet, so no episode is known"):
        read_trajectory(v30)


def test_rows_that_contradict_the_metadata(v21: Path, v30: Path) -> None:
    short = v21 / "data/chunk-000/episode_000001.parquet"
    rewrite(short, lambda table: table.slice(0, 40))
    with pytest.raises(ValueError, match=r"episode_000001.parquet: 40 rows of episode 1, but .* 45"):
        read_trajectory(v21)
    rewrite(v30 / "data/chunk-000/file-000.parquet", lambda table: table.take([*range(50, 105), *range(50)]))
    with pytest.raises(ValueError, match=r"the 60 rows of episode 0 do not stand together"):
        read_trajectory(v30)


def test_actions_of_another_length_in_some_rows(v21: Path) -> None:
    file = v21 / "data/chunk-000/episode_000000.parquet"
    rows = pq.read_table(file)["action"].to_pylist()
    rows[7] = rows[7][:5]
    rewrite(file, lambda table: set_column(table, "action", pa.array(rows, pa.list_(pa.float32()))))
    with pytest.raises(ValueError, match=r"row 7 of episode 0 has 5 numbers in 'action'"):
        read_trajectory(v21)


def test_times_that_run_back(v21: Path) -> None:
    file = v21 / "data/chunk-000/episode_000000.parquet"
    times = pq.read_table(file)["timestamp"].to_pylist()
    times[9] = times[7]
    rewrite(file, lambda table: set_column(table, "timestamp", pa.array(times, pa.float32())))
    with pytest.raises(ValueError, match=r"episode 0 goes from 0.266667 s to 0.233333 s at its row 9"):
        read_trajectory(v21)


def test_uneven_times_are_kept(v21: Path) -> None:
    file = v21 / "data/chunk-000/episode_000000.parquet"
    times = np.array(pq.read_table(file)["timestamp"].to_pylist())
    times[30:] += 0.01
    rewrite(file, lambda table: set_column(table, "timestamp", pa.array(times, pa.float32())))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        motion = read_trajectory(v21)
    np.testing.assert_allclose(motion.time_s[:60], times, atol=1e-6)
