"""Bags of both storages give the same messages, and every way in which a bag can be wrong."""

import shutil
import sqlite3
import warnings
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import CompressionMode

from lagsplat.io.config import McapConfig, McapInputConfig
from lagsplat.io.robot_log.recording import read_log
from lagsplat.io.robot_log.storage import hash_log, is_log, list_log_files, read_messages
from lagsplat.io.robot_log.trajectory import read_log_trajectory
from lagsplat.video_quality.frames import FrameSettings
from tests.unit.io.robot_log.bag_files import (
    STORAGES,
    arm,
    camera_rows,
    command_rows,
    joint_rows,
    split_bag,
    storage_file,
    write_bag,
)
from tests.unit.io.robot_log.mcap_files import START_NS, take

both = pytest.mark.parametrize("storage", STORAGES)


def read(path: Path) -> tuple[list[tuple[str, int, bytes]], list[str]]:
    losses: list[str] = []
    found = [
        (channel.topic, message.log_time, message.data) for _, channel, message in read_messages(path, losses)
    ]
    return found, losses


@both
@pytest.mark.parametrize("compress", [CompressionMode.MESSAGE, CompressionMode.FILE])
def test_a_compressed_bag_holds_the_same_messages(
    tmp_path: Path, storage: str, compress: CompressionMode
) -> None:
    rows = [*joint_rows(arm()), *command_rows(arm())]
    plain, no_losses = read(write_bag(tmp_path / "plain", rows, storage))
    packed, losses = read(write_bag(tmp_path / "packed", rows, storage, compress=compress))
    assert plain == packed
    assert len(plain) == len(rows)
    assert no_losses == losses == []


@both
def test_a_split_bag_a_lone_file_and_one_without_metadata(tmp_path: Path, storage: str) -> None:
    rows = joint_rows(arm())
    whole, _ = read(write_bag(tmp_path / "whole", rows, storage))
    split = split_bag(tmp_path / "take", rows, storage, parts=12)  # numbers of two digits
    assert is_log(split)
    assert read(split) == (whole, [])
    assert len(list_log_files(split)) == 12
    assert len({hash_log(split), hash_log(tmp_path / "whole"), hash_log(list_log_files(split)[0])}) == 3
    lone, _ = read(storage_file(tmp_path / "whole"))
    assert lone == whole
    (split / "metadata.yaml").unlink()
    messages, (loss,) = read(split)
    assert messages == whole
    assert "metadata.yaml is missing" in loss
    (split / "metadata.yaml").write_text("a: [")
    messages, (loss,) = read(split)
    assert messages == whole
    assert "metadata.yaml cannot be read" in loss


def test_mcap_files_in_a_folder_of_another_name_are_no_bag(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "arm", joint_rows(arm()), "mcap")
    logs = tmp_path / "logs"
    logs.mkdir()
    shutil.copy(storage_file(bag), logs / "monday.mcap")
    assert not is_log(logs)
    assert not is_log(tmp_path)
    assert is_log(logs / "monday.mcap")


@both
@pytest.mark.parametrize("share", [0.4, pytest.param(0.61, marks=pytest.mark.campaign), 0.8])
def test_what_is_whole_of_a_bag_cut_short_is_read(tmp_path: Path, storage: str, share: float) -> None:
    of = arm(9000)
    bag = write_bag(tmp_path / "bag", joint_rows(of), storage)
    whole, _ = read(bag)
    file = storage_file(bag)
    file.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])
    messages, losses = read(bag)
    assert messages == whole[: len(messages)]
    assert 0.5 * share * len(whole) < len(messages) < len(whole)
    assert any("cut short" in loss or "without its footer" in loss for loss in losses)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        motion = read_log_trajectory(bag)
    assert "messages are whole, the last one logged at" in " ".join(str(each.message) for each in caught)
    np.testing.assert_allclose(motion.q[:, ::-1], of.q[: motion.n])


@both
def test_a_compressed_file_cut_short_gives_its_beginning(tmp_path: Path, storage: str) -> None:
    rows = joint_rows(arm(9000))
    whole, _ = read(write_bag(tmp_path / "whole", rows, storage))
    file = storage_file(write_bag(tmp_path / "bag", rows, storage, compress=CompressionMode.FILE))
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    messages, losses = read(tmp_path / "bag")
    assert "the compressed file is cut short" in losses
    assert messages == whole[: len(messages)]
    assert 0 < len(messages) < len(whole)
    file.write_bytes(b"no zstd at all")
    with pytest.raises(ValueError, match=rf"{file.name}: zstd can decompress nothing"):
        read(tmp_path / "bag")


def test_a_damaged_message_is_counted(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", joint_rows(arm(50)), "sqlite3", compress=CompressionMode.MESSAGE)
    with sqlite3.connect(storage_file(bag)) as database:
        database.execute("UPDATE messages SET data = substr(data, 1, 20) WHERE id = 7")
    messages, losses = read(bag)
    assert len(messages) == 49
    assert losses == ["1 compressed messages are damaged and left out"]


def test_files_of_a_split_bag_that_are_lost_are_named(tmp_path: Path) -> None:
    rows = joint_rows(arm())
    bag = split_bag(tmp_path / "take", rows, "sqlite3")
    whole, _ = read(bag)
    (bag / "take_1.db3").write_bytes(b"")  # opened by a recorder that was killed at once
    messages, (loss,) = read(bag)
    assert messages == [*whole[:66], *whole[133:]]
    assert loss.startswith("take_1.db3: its topics cannot be read")
    (bag / "take_1.db3").unlink()
    messages, losses = read(bag)
    assert losses == ["take_1.db3 is missing, which metadata.yaml names"]
    with pytest.warns(UserWarning, match="take_1.db3 is missing"):
        motion = read_log_trajectory(bag)
    assert len(motion.segments) == 2
    for name in ("take_0.db3", "take_2.db3"):
        (bag / name).write_bytes(b"nothing")
    with pytest.raises(ValueError, match=r"take_0\.db3: its topics cannot be read.*copy it again"):
        read(bag)
    for name in ("take_0.db3", "take_2.db3"):
        (bag / name).unlink()
    with pytest.raises(FileNotFoundError, match=r"no file of this bag is there \(take_0\.db3"):
        list_log_files(bag)
    with pytest.raises(FileNotFoundError, match="no such file"):
        list_log_files(tmp_path / "gone.db3")
    (tmp_path / "a.lz4").write_bytes(b"")
    with pytest.raises(ValueError, match=r"a\.lz4: \.lz4 is not read"):
        read(tmp_path / "a.lz4")


def test_what_a_killed_recorder_left_in_its_journal_is_read(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", joint_rows(arm(50)), "sqlite3")
    file = storage_file(bag)
    database = sqlite3.connect(file)
    database.execute("PRAGMA journal_mode = WAL")
    database.execute(
        "INSERT INTO messages SELECT 1000, topic_id, timestamp, data FROM messages WHERE id = 50"
    )
    database.commit()
    killed = tmp_path / "killed"
    shutil.copytree(bag, killed)  # before the journal is closed
    database.close()
    journal = killed / f"{file.name}-wal"
    before = journal.read_bytes(), sorted(path.name for path in killed.iterdir())
    messages, _ = read(killed)
    assert len(messages) == 51
    assert before == (journal.read_bytes(), sorted(path.name for path in killed.iterdir()))


@both
def test_a_camera_in_a_bag_gives_the_recording(tmp_path: Path, storage: str) -> None:
    film = take()
    bag = write_bag(tmp_path / "bag", [*camera_rows(film), *joint_rows(arm())], storage)
    inputs = [McapInputConfig("/joint_states", "position[elbow]", "elbow", "rad")]
    recording = read_log(bag, McapConfig("/camera", inputs, "header", 0.5), FrameSettings())
    kept = film.frame_ns >= arm().ns[0]
    np.testing.assert_array_equal(recording.frames, film.frames[kept])
    expected = np.interp(film.frame_ns[kept], arm().ns, arm().q[:, 1])
    np.testing.assert_allclose(recording.inputs[:, 0], expected, atol=1e-12)
    assert recording.meta["start_ns"] == START_NS + film.frame_ns[0]
    assert recording.meta["sha256"] == hash_log(bag)
    with pytest.raises(ValueError, match=r"'/camra' \(did you mean '/camera'\?\).*joint_states \(200\)"):
        read_log(bag, McapConfig("/camra", [], "header", 0.5), FrameSettings())
