"""The film of one camera with its rows: frames and numbers belong together, and damage is named."""

import shutil
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lagsplat.io.config import LerobotConfig
from lagsplat.io.lerobot.recording import read_lerobot
from lagsplat.io.lerobot.survey import survey_lerobot
from lagsplat.io.recording.recording import Recording
from lagsplat.report.inspection.dataset import describe_lerobot
from lagsplat.video_quality.frames import FrameSettings
from tests.unit.io.lerobot.datasets import NAMES, block, change_info, rewrite, rows_of, scale

FRONT = LerobotConfig("observation.images.front", ["action"], episodes=None, joint_unit=None)


def read(folder: Path, chosen: LerobotConfig = FRONT, settings: FrameSettings | None = None) -> Recording:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of short films of a square
        return read_lerobot(folder, chosen, settings or FrameSettings())


def left_edges(recording: Recording, row: int) -> list[int]:
    """Column of the left edge of the square of `make_data` [pixel], in the rows from ``row`` on."""
    bright = recording.frames[:, row : row + 8].mean(axis=(1, 3)) > 135
    return bright.argmax(axis=1).tolist()


def test_frames_and_rows_of_every_episode_belong_together(dataset: Path) -> None:
    recording = read(dataset)
    assert recording.frames.shape == (105, 48, 64, 3)
    assert recording.segments == ((0, 60), (60, 105))
    # the square moves a pixel a frame, and the codec blurs its edge
    np.testing.assert_allclose(left_edges(recording.part(0, 50), 10), np.arange(50), atol=1)
    np.testing.assert_allclose(left_edges(recording.part(60, 105), 26), np.arange(45), atol=1)
    np.testing.assert_allclose(recording.inputs[:, 2], np.deg2rad(block(rows_of(dataset), "action")[:, 2]))
    assert recording.input_names == NAMES
    assert recording.input_units == (*["rad"] * 5, "as written")
    assert recording.meta["episodes"] == [0, 1]
    assert len(recording.meta["footage"]) == 2


def test_one_episode_a_cut_and_single_numbers(dataset: Path) -> None:
    names = ["observation.state.elbow_flex.pos", "action.elbow_flex.pos"]
    chosen = replace(FRONT, episodes=[1], inputs=names, joint_unit="as_written")
    recording = read(dataset, chosen, FrameSettings(skip_s=0.5, end_s=1.0, size=(24, 32)))
    assert recording.frames.shape == (15, 24, 32, 3)
    np.testing.assert_allclose(left_edges(recording, 13), np.arange(15, 30) / 2, atol=1)
    np.testing.assert_allclose(recording.time_s, np.arange(15, 30) / 30)
    own = rows_of(dataset).slice(75, 15)
    np.testing.assert_allclose(recording.inputs[:, 0], block(own, "observation.state")[:, 2])
    np.testing.assert_allclose(recording.inputs[:, 1], block(own, "action")[:, 2])
    assert recording.input_names == ("observation.state.elbow_flex.pos", "elbow_flex.pos")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"camera": None}, r"camera is null; cameras .*images.front, observation.images.wrist. Set"),
        ({"camera": "front"}, r"no camera 'front'; cameras .*images.front, observation.images.wrist"),
        ({"inputs": ["torque"]}, r"no number 'torque' .* features are action, observation.state"),
        ({"episodes": [2]}, r"episodes \[2\]; there are episodes 0 to 1"),
        ({"episodes": []}, r"episodes \[\]; there are"),
    ],
)
def test_what_does_not_exist_is_named(dataset: Path, changes: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        read(dataset, replace(FRONT, **changes))


def test_a_cut_that_leaves_nothing(v21: Path) -> None:
    with pytest.raises(ValueError, match=r"no frame to keep of episode 0, which lasts 1\.967 s"):
        read(v21, settings=FrameSettings(skip_s=5.0))


def test_a_unit_is_needed_only_by_joints_that_are_inputs(v21: Path) -> None:
    scale(v21, 0.5)
    with pytest.raises(ValueError, match="no unit of the joints"):
        read(v21)
    assert read(v21, replace(FRONT, inputs=[])).inputs.shape == (105, 0)


def test_pictures_inside_tables_are_refused(v21: Path) -> None:
    change_info(v21, lambda info: info["features"]["observation.images.front"].update(dtype="image"))
    with pytest.raises(ValueError, match=r"single pictures inside the tables.*cameras with films: .*wrist"):
        read(v21)


def film_of(folder: Path) -> Path:
    return sorted((folder / "videos").rglob("*.mp4"))[0]


def test_a_missing_film_is_named_before_anything_is_decoded(dataset: Path) -> None:
    film_of(dataset).unlink()
    with pytest.raises(FileNotFoundError, match=r"\.mp4: missing, the film of observation.images.front"):
        read(dataset)
    assert ".mp4 is missing" in describe_lerobot(survey_lerobot(dataset))


def test_a_truncated_film_is_named(dataset: Path) -> None:
    film = film_of(dataset)
    content = film.read_bytes()
    film.write_bytes(content[: len(content) * 2 // 3])
    with pytest.raises(ValueError, match=rf"{film.name}: (truncated, or no film|episode \d has).* again"):
        read(dataset)
    assert "bytes at its end" in describe_lerobot(survey_lerobot(dataset))
    film.write_bytes(b"")
    with pytest.raises(ValueError, match=rf"{film.name}: truncated, or no film"):
        read(dataset)


def test_a_film_of_fewer_frames_than_rows_is_refused(v21: Path, v30: Path) -> None:
    films = sorted((v21 / "videos").rglob("*front/*.mp4"))
    shutil.copy(films[1], films[0])  # 45 frames for 60 rows
    with pytest.raises(ValueError, match=r"episode 0 has 60 rows, but no picture for row 45 at 1\.500 s"):
        read(v21)
    column = "videos/observation.images.front/from_timestamp"
    file = v30 / "meta/episodes/chunk-000/file-000.parquet"
    rewrite(
        file,
        lambda table: table.set_column(table.column_names.index(column), column, [[0.0, 3.0]]),
    )
    with pytest.raises(ValueError, match=r"episode 1 has 45 rows, but no picture for row 15 at 3\.500 s"):
        read(v30)


def test_without_pyav_the_way_to_install_it_is_said(v21: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(ValueError, match=r"pip install 'lagsplat\[lerobot\]'"):
        read(v21)
    assert "2 of 45 to 60 frames" in describe_lerobot(survey_lerobot(v21))


def test_a_survey_says_what_there_is_and_how_to_use_it(dataset: Path) -> None:
    told = describe_lerobot(survey_lerobot(dataset))
    version = dataset.name[1] + "." + dataset.name[2]
    assert f"(LeRobot {version}, so100_follower)" in told
    assert "3.500 s, 30 frames/s" in told
    assert "action, float32 [6]: shoulder_pan.pos" in told
    assert "camera     observation.images.front, 64 x 48 px" in told
    assert "converted from degrees to radians" in told
    assert f"lagsplat diagnose sim=SIM real={dataset}" in told
    assert "recording.lerobot.camera=observation.images.front" in told
    assert "damaged" not in told


def test_a_survey_lists_damage_and_asks_for_the_unit(v21: Path) -> None:
    scale(v21, 0.5)
    (v21 / "data/chunk-000/episode_000001.parquet").write_bytes(b"PAR1")
    told = describe_lerobot(survey_lerobot(v21))
    assert "damaged" in told
    assert "episode_000001.parquet: truncated or no Parquet file" in told
    assert "unit       to be given by joint_unit" in told
    assert "diagnose.joint_unit=degree" in told
    assert "recording.lerobot.joint_unit=degree" in told
