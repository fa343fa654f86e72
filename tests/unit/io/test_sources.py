"""What the arguments name: one file, a list, a pattern, a folder, a run, a model, an object."""

import os
from pathlib import Path

import numpy as np
import pytest

from lagsplat.io.files.artifact import save_artifact
from lagsplat.io.read import read_trajectory
from lagsplat.io.recording.recording import Recording, save_recording
from lagsplat.io.sources import (
    DataSource,
    adopt_names,
    find_sources,
    prefer_numbers,
    read_sources,
)
from lagsplat.io.trajectory.trajectory import Trajectory
from tests.unit.io.robot_log.bag_files import (
    STORAGES,
    arm,
    camera_rows,
    joint_rows,
    split_bag,
    storage_file,
    write_bag,
)
from tests.unit.io.robot_log.mcap_files import take


def kinds(argument: object) -> list[tuple[str, str]]:
    return [(source.kind, Path(source.path).name) for source in find_sources(str(argument))]


def film(n: int = 10, **fields: object) -> Recording:
    given = {
        "frames": np.zeros((n, 2, 2, 3), np.uint8),
        "time_s": np.arange(n) / 10.0,
        "inputs": np.zeros((n, 0)),
        "input_names": (),
        "input_units": (),
        "meta": {"origin": "filmed"},
    }
    return Recording(**(given | fields))  # type: ignore[arg-type]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("take10.csv", "take2.csv", "notes.md"):
        (tmp_path / name).write_text("t,q0\n0,1\n0.1,2\n0.2,4\n")
    return tmp_path


def test_files_lists_patterns_and_folders(folder: Path) -> None:
    two = [("trajectory", "take2.csv"), ("trajectory", "take10.csv")]
    assert kinds(folder / "take2.csv") == two[:1]
    assert kinds(f"[{folder / 'take2.csv'}, '{folder / 'take10.csv'}']") == two
    assert kinds(folder / "take*.csv") == two
    assert kinds(folder) == two
    assert kinds(f"[{folder / 'take2.csv'},{folder / '*.csv'}]") == two
    motions = read_sources(find_sources(str(folder)))
    assert [motion.source for motion in motions] == ["take2.csv", "take10.csv"]


def test_a_pattern_is_taken_from_here(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    assert kinds("take?.csv") == [("trajectory", "take2.csv")]
    assert os.fspath(find_sources("take2.csv")[0].path) == "take2.csv"


def test_content_decides_about_archives_and_artefacts(tmp_path: Path) -> None:
    np.savez(tmp_path / "arm.npz", images=np.zeros((1, 3, 2, 2)), p1=np.zeros(1))
    np.savez(tmp_path / "log.npz", t=np.arange(3.0), q0=np.arange(3.0))
    save_recording(tmp_path / "recording.safetensors", film())
    save_artifact(tmp_path / "augmented.safetensors", {"x": np.zeros(1)}, {"kind": "augmented", "schema": 1})
    assert kinds(tmp_path / "arm.npz") == [("krauss", "arm.npz")]
    assert kinds(tmp_path / "log.npz") == [("trajectory", "log.npz")]
    assert kinds(tmp_path / "recording.safetensors") == [("recording", "recording.safetensors")]
    assert kinds(tmp_path / "augmented.safetensors") == [("model", "augmented.safetensors")]
    save_artifact(tmp_path / "dynamics.safetensors", {"x": np.zeros(1)}, {"kind": "dynamics", "schema": 1})
    assert kinds(tmp_path) == [("run", tmp_path.name)]
    assert kinds(tmp_path / "dynamics.safetensors") == [("run", tmp_path.name)]


def test_films_take_the_table_of_their_name_along(tmp_path: Path) -> None:
    for name in ("bag.mp4", "log.mcap", "arm.xml", "bag.csv", "other.csv"):
        (tmp_path / name).write_text("")
    assert find_sources(str(tmp_path / "bag.mp4")) == (
        DataSource("video", str(tmp_path / "bag.mp4"), str(tmp_path / "bag.csv")),
    )
    assert kinds(tmp_path) == [("video", "bag.mp4"), ("mcap", "log.mcap"), ("trajectory", "other.csv")]
    assert kinds(tmp_path / "arm.xml") == [("mujoco", "arm.xml")]
    pictures = tmp_path / "frames"
    pictures.mkdir()
    (pictures / "img1.png").write_text("")
    assert kinds(pictures) == [("video", "frames")]


@pytest.mark.parametrize("storage", STORAGES)
def test_a_log_is_a_film_if_it_has_a_camera_and_else_a_trajectory(tmp_path: Path, storage: str) -> None:
    split_bag(tmp_path / "joints", joint_rows(arm()), storage)
    write_bag(tmp_path / "seen", [*joint_rows(arm()), *camera_rows(take())], storage)
    file = storage_file(tmp_path / "seen")
    assert kinds(tmp_path / "joints") == [("trajectory", "joints")]
    assert kinds(tmp_path / "seen") == [("mcap", "seen")]
    assert kinds(file) == [("mcap", file.name)]
    sources = find_sources(str(tmp_path / "seen"))
    assert prefer_numbers(sources, {"q0": "/joint_states.position[elbow]"})[0].kind == "trajectory"
    assert prefer_numbers(sources, {"q0": "angle"}) == sources
    for name in ("joints", "seen"):  # beside a sim that has no images, a log gives its numbers
        (motion,) = read_sources(find_sources(str(tmp_path / name)))
        np.testing.assert_array_equal(motion.q[:, ::-1], arm().q)
    only_seen = write_bag(tmp_path / "film", camera_rows(take()), storage)
    with pytest.raises(
        ValueError, match=r"0 topics of JointState.*Its images are compared where sim= is a film"
    ):
        read_sources(find_sources(str(only_seen)))


def test_a_run_with_its_exported_log_is_a_run(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", joint_rows(arm(20)), "mcap")
    run = tmp_path / "run"
    run.mkdir()
    storage_file(bag).rename(run / "run.mcap")
    assert kinds(run) == [("trajectory", "run")]
    (run / "dynamics.safetensors").write_text("")
    assert kinds(run) == [("run", "run")]


def test_columns_of_a_log_leave_a_table_with_standard_names_alone(tmp_path: Path) -> None:
    (tmp_path / "sim.csv").write_text("t,q0,u0\n0,1,2\n1,3,4\n")
    columns = {"t": "log", "q0": "/joint_states.position[elbow]"}
    assert read_trajectory(tmp_path / "sim.csv", columns=columns).q.tolist() == [[1.0], [3.0]]
    with pytest.raises(ValueError, match="no column 'angle' for q0"):
        read_trajectory(tmp_path / "sim.csv", columns={"q0": "angle"})
    (tmp_path / "other.csv").write_text("t,/elbow/position\n0,1\n1,3\n")
    assert read_trajectory(tmp_path / "other.csv", columns={"q0": "/elbow/position"}).d == 1


def test_objects_are_named_by_module_and_attribute() -> None:
    assert kinds("my_model:build") == [("python", "my_model:build")]
    assert kinds("models/arm.py:build") == [("python", "arm.py:build")]


@pytest.mark.parametrize("argument", ["nothing.csv", "no*.csv", "[nothing.csv]"])
def test_what_is_not_there_is_said(argument: str) -> None:
    with pytest.raises(FileNotFoundError, match="no such file or folder, and no pattern"):
        find_sources(argument)


def test_what_is_not_known_is_said(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text("")
    (tmp_path / "a.npz").write_text("")
    with pytest.raises(ValueError, match=r"\.xyz is neither a trajectory"):
        find_sources(str(tmp_path / "a.xyz"))
    with pytest.raises(ValueError, match="damaged or not an NPZ"):
        find_sources(str(tmp_path / "a.npz"))
    (tmp_path / "arm.py").write_text("")
    with pytest.raises(ValueError, match="name what in it is the simulator"):
        find_sources(str(tmp_path / "arm.py"))
    with pytest.raises(ValueError, match="an empty list"):
        find_sources("[]")
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileNotFoundError, match="a folder without"):
        find_sources(str(tmp_path / "empty"))
    with pytest.raises(ValueError, match="is a model and has no trajectory"):
        read_sources([DataSource("mujoco", "arm.xml")])
    with pytest.raises(ValueError, match="needs the encoder of a fitted run"):
        read_sources([DataSource("video", "bag.mp4")])


DATASET = Path(__file__).parent / "lerobot" / "data" / "v30"


@pytest.mark.filterwarnings("ignore:v30. joints are converted")
def test_a_lerobot_dataset_is_one_trajectory_whose_joints_take_the_names_of_the_sim() -> None:
    assert kinds(DATASET) == [("trajectory", "v30")]
    motions = read_sources(find_sources(str(DATASET)))
    assert motions[0].q_names[0] == "shoulder_pan.pos"
    sim = Trajectory(np.arange(3.0), q=np.zeros((3, 6)), u=np.zeros((3, 6)))
    with pytest.warns(UserWarning, match=r"q0 is shoulder_pan\.pos.*u5 is gripper\.pos_target"):
        (named,) = adopt_names(motions, [sim])
    assert (named.q_names, named.u_names) == (sim.q_names, sim.u_names)
    assert adopt_names(motions, motions) == adopt_names(motions, []) == motions
    other = Trajectory(np.arange(3.0), q=np.zeros((3, 2)), u=np.zeros((3, 6)))
    assert adopt_names(motions, [other]) == motions  # a check refuses them by both lists of names


def test_notes_beside_a_film_are_not_its_inputs(tmp_path: Path) -> None:
    for name in ("bag.mp4", "bag.txt", "arm.mp4", "arm.csv"):
        (tmp_path / name).write_bytes(b"")
    arm, bag = find_sources(str(tmp_path))
    assert arm.inputs == str(tmp_path / "arm.csv")
    assert bag.inputs is None
