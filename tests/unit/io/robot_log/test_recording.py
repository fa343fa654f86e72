"""Recordings from MCAP: the same from every writer, and every way a log can be wrong."""

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lagsplat.io.config import McapInputConfig
from lagsplat.io.recording.recording import Recording
from lagsplat.io.robot_log.recording import read_log
from lagsplat.video_quality.frames import FrameSettings
from tests.unit.io.robot_log.mcap_files import (
    START_NS,
    WRITERS,
    Take,
    by_json,
    by_rosbags,
    by_this_package,
    json_take,
    take,
    topics,
)

ONE = [McapInputConfig("/joints", "x", "x", "N")]


def read(path: Path, config: Any, **changes: Any) -> Recording:
    return read_log(path, config, FrameSettings(**changes))


def interpolated(film: Take) -> np.ndarray:
    return np.stack([np.interp(film.frame_ns, film.joint_ns, column) for column in film.angles.T], axis=1)


@pytest.mark.parametrize("writer", WRITERS)
def test_every_writer_gives_the_recording(tmp_path: Path, writer: str) -> None:
    film = take()
    config = WRITERS[writer](tmp_path / "log.mcap", film)
    recording = read(tmp_path / "log.mcap", config)
    np.testing.assert_array_equal(recording.frames, film.frames)
    np.testing.assert_array_equal(recording.time_s, (film.frame_ns - film.frame_ns[0]) / 1e9)
    np.testing.assert_allclose(recording.inputs, interpolated(film), atol=1e-12)
    assert recording.input_names == ("shoulder", "elbow")
    assert recording.input_units == ("rad", "rad")
    assert recording.segments == ((0, len(film.frames)),)
    assert recording.meta["origin"] == "filmed"
    assert recording.meta["start_ns"] == START_NS + film.frame_ns[0]


def test_raw_pictures_with_padded_rows(tmp_path: Path) -> None:
    film = take()
    config = by_rosbags(tmp_path / "log.mcap", film, raw=True)
    np.testing.assert_array_equal(read(tmp_path / "log.mcap", config).frames, film.frames)


def test_pictures_are_cut_like_those_of_a_film(tmp_path: Path) -> None:
    film = take()
    config = by_this_package(tmp_path / "log.mcap", film)
    cut = read(tmp_path / "log.mcap", config, crop=[2, 1, 4, 4], size=(2, 2), skip_s=0.2, end_s=0.4)
    since = (film.frame_ns - film.frame_ns[0]) / 1e9
    kept = (since >= 0.2) & (since < 0.4)
    np.testing.assert_array_equal(cut.time_s, since[kept])
    blocks = film.frames[kept, 1:5, 2:6].reshape(-1, 2, 2, 2, 2, 3).mean(axis=(2, 4))
    np.testing.assert_allclose(cut.frames, blocks, atol=0.51)
    np.testing.assert_allclose(cut.inputs, interpolated(film)[kept], atol=1e-12)


@pytest.mark.parametrize("writer", WRITERS)
@pytest.mark.parametrize("share", [0.5, 0.7, 0.9])
def test_a_file_cut_short_gives_what_is_whole(tmp_path: Path, writer: str, share: float) -> None:
    film = take(400)  # several blocks of a codec
    config = WRITERS[writer](tmp_path / "log.mcap", film)
    content = (tmp_path / "log.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(content[: int(share * len(content))])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording = read(tmp_path / "cut.mcap", config)
    told = " ".join(str(warning.message) for warning in caught)
    assert "ends without its footer" in told
    assert "messages are whole, the last one logged at" in told
    n = recording.n_frames
    assert 0.2 * share * len(film.frames) < n
    np.testing.assert_array_equal(recording.frames, film.frames[:n])


def test_a_damaged_chunk_is_left_out_and_the_recording_cut_there(tmp_path: Path) -> None:
    film = take(60)
    path = tmp_path / "log.mcap"
    rows = sorted(json_take(film), key=lambda row: row[1])
    by_json(path, rows, chunk_size=4000)
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(content)
    config = topics(inputs=ONE, max_gap_s=0.05)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording = read(path, config)
    assert "a chunk of" in str(caught[0].message)
    assert "s is damaged" in str(caught[0].message)
    assert 40 < recording.n_frames < 60
    assert np.diff(recording.time_s).max() > 0.1
    wide = 1 + np.argmax(np.diff(recording.time_s))
    assert wide in {start for start, _ in recording.segments}


def test_frames_without_inputs_are_dropped_and_gaps_cut(tmp_path: Path) -> None:
    film = take(20)
    since = film.joint_ns / 1e9
    held = (since > 0.1) & ~((since > 0.4) & (since < 0.6))
    film = replace(film, joint_ns=film.joint_ns[held], angles=film.angles[held])
    config = by_this_package(tmp_path / "log.mcap", film)
    with pytest.warns(UserWarning, match="frames are dropped: .* outside the inputs .* inside gaps"):
        recording = read(tmp_path / "log.mcap", replace(config, max_gap_s=0.1))
    frame_s = film.frame_ns / 1e9
    kept = (frame_s >= film.joint_ns[0] / 1e9) & ~((frame_s > 0.4) & (frame_s < 0.6))
    assert recording.n_frames == kept.sum()
    (_, border), (again, _) = recording.segments
    assert border == again == (kept & (frame_s < 0.5)).sum()
    with pytest.warns(UserWarning, match="outside the inputs"):
        assert len(read(tmp_path / "log.mcap", config).segments) == 1


def test_camera_and_log_that_do_not_overlap(tmp_path: Path) -> None:
    film = take()
    by_this_package(tmp_path / "log.mcap", replace(film, joint_ns=film.joint_ns + 10**10))
    message = r"camera and input 'shoulder' do not overlap; the camera runs from 0\.000 s to 0\.5.*from 9\.9"
    with pytest.raises(ValueError, match=message):
        read(tmp_path / "log.mcap", topics(fields=("shoulder", "elbow")))


def test_what_is_not_there_is_named(tmp_path: Path) -> None:
    path, film = tmp_path / "log.mcap", take()
    config = by_rosbags(path, film)
    with pytest.raises(ValueError, match=r"'/camra' \(did you mean '/camera'\?\).*/joints \(66\)"):
        read(path, replace(config, camera="/camra"))
    wrong = [McapInputConfig("/joints", "positon[elbow]", "a", "rad")]
    with pytest.raises(
        ValueError, match=r"message 0: field 'positon\[elbow\]' is no number.*position\[elbow\]"
    ):
        read(path, replace(config, inputs=wrong))
    with pytest.raises(ValueError, match="/joints holds sensor_msgs/msg/JointState, which is no picture"):
        read(path, replace(config, camera="/joints"))
    with pytest.raises(FileNotFoundError, match="no such file"):
        read(tmp_path / "gone.mcap", config)
    (tmp_path / "film.mcap").write_bytes(b"not a log at all")
    with pytest.raises(ValueError, match="does not begin as an MCAP file"):
        read(tmp_path / "film.mcap", config)
    with pytest.raises(ValueError, match="no frame to keep"):
        read(path, config, skip_s=5.0)
    by_json(tmp_path / "empty.mcap", [])
    with pytest.raises(ValueError, match="topics with messages: none"):
        read(tmp_path / "empty.mcap", config)


def test_clocks_that_cannot_be_used_point_to_the_other(tmp_path: Path) -> None:
    path, film = tmp_path / "log.mcap", take()
    config = topics(inputs=[])
    stamps = [int(ns) + START_NS for ns in film.frame_ns]
    back = [*stamps[:5], *(ns - 10**9 for ns in stamps[5:])]
    by_json(path, json_take(film, header_ns=back))
    message = r"header clock jumps back from .* \(message 4\) to .* \(message 5\), 1 such.*mcap\.clock=log"
    with pytest.raises(ValueError, match=message):
        read(path, config)
    assert read(path, replace(config, clock="log")).n_frames == 12
    assert read(path, config, end_s=0.1).n_frames < 5  # the cut ends before the jump
    by_json(path, json_take(film, log_ns=back))
    with pytest.raises(ValueError, match=r"log clock jumps back.*mcap\.clock=header"):
        read(path, replace(config, clock="log"))
    by_json(path, json_take(film, header_ns=back, log_ns=back))
    with pytest.raises(ValueError, match="no better; cut the file"):
        read(path, config)
    by_json(path, json_take(film, header_ns=[0] * 12))
    with pytest.raises(ValueError, match=r"never set.*mcap\.clock=log"):
        read(path, config)
    by_json(path, json_take(film, header_ns=[None] * 12))
    with pytest.raises(ValueError, match=r"has no stamp; use recording\.mcap\.clock=log"):
        read(path, config)
    by_json(path, json_take(film, header_ns=[stamps[0], stamps[0], *stamps[2:]]))
    with pytest.warns(UserWarning, match="1 of 12 messages carry the stamp of the one before"):
        recording = read(path, config)
    np.testing.assert_array_equal(recording.frames, np.delete(film.frames, 1, axis=0))


def test_pictures_and_numbers_that_are_damaged_are_counted(tmp_path: Path) -> None:
    path, film = tmp_path / "log.mcap", take()
    rows = json_take(film)
    rows[3][2]["data"] = "AAAA"
    by_json(path, rows)
    with pytest.warns(UserWarning, match=r"1 pictures cannot be decoded .* message 3: 3 bytes of"):
        recording = read(path, topics(inputs=[]))
    np.testing.assert_array_equal(recording.frames, np.delete(film.frames, 3, axis=0))
    rows[0][2]["data"] = "AAAA"
    by_json(path, rows)
    with pytest.raises(ValueError, match="message 0: 3 bytes"):
        read(path, topics(inputs=[]))
    rows = json_take(film)
    for row in rows[-20:-10]:
        row[2]["x"] = float("nan")
    by_json(path, rows)
    with pytest.warns(UserWarning, match="10 of 66 values of x are not finite"):
        np.testing.assert_array_equal(read(path, topics(inputs=ONE)).inputs, 1.0)
    other = replace(film, frames=film.frames[:, :4])
    by_json(path, [*json_take(film)[:6], *json_take(other)[6:]])
    with pytest.raises(ValueError, match=r"recording\.height and recording\.width"):
        read(path, topics(inputs=[]))
    assert read(path, topics(inputs=[]), size=(3, 3)).frames.shape == (12, 3, 3, 3)
