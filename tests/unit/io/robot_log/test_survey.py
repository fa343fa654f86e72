"""What a survey finds, and that what it suggests can be typed and read."""

import shlex
from pathlib import Path

import numpy as np
import pytest

from lagsplat.config.compose import compose
from lagsplat.io.read import read_recording
from lagsplat.io.robot_log.survey import survey_log
from lagsplat.report.inspection.log import describe_log, suggest_overrides
from tests.unit.io.robot_log.mcap_files import START_NS, WRITERS, by_json, by_rosbags, json_take, take


@pytest.mark.parametrize("writer", WRITERS)
def test_what_is_suggested_makes_the_recording(tmp_path: Path, writer: str) -> None:
    film, path = take(), tmp_path / "a log.mcap"
    WRITERS[writer](path, film)
    found = survey_log(path)
    camera, joints = found.topics
    assert (camera.name, joints.name) == ("/camera", "/joints")
    assert camera.picture == "compressed"
    assert len(joints.log_ns) == len(film.joint_ns)
    assert joints.rate_hz == pytest.approx(100.0)
    assert joints.longest_gap_s == pytest.approx(0.01)
    assert len(joints.moving) == 2
    told = describe_log(found)
    block = told[told.index("recording=filmed") :].replace("\\\n", " ").partition("\n")[0]
    words = shlex.split(block)
    assert words == suggest_overrides(found)
    recording = read_recording(compose(*words).recording)
    np.testing.assert_array_equal(recording.frames, film.frames)
    expected = [np.interp(film.frame_ns[3], film.joint_ns, column) for column in film.angles.T]
    assert sorted(recording.inputs[3]) == pytest.approx(sorted(expected))


def test_clocks_and_damage_are_told(tmp_path: Path) -> None:
    film, path = take(), tmp_path / "log.mcap"
    stamps = [int(ns) + START_NS for ns in film.frame_ns]
    back = [*stamps[:5], *(ns - 10**9 for ns in stamps[5:])]
    by_json(path, [*json_take(film, header_ns=back), ("/odd", START_NS, {"a": 1.0})])
    told = describe_log(survey_log(path))
    assert "warning    /camera: the header clock jumps back 1 times" in told
    assert "recording.mcap.clock=log" in told
    assert "recording.mcap.inputs=[]" in told  # the number never changes
    assert "/odd" in told
    by_json(path, json_take(film, header_ns=[5] * 12))
    assert "all header stamps are the same" in describe_log(survey_log(path))
    path.write_bytes(path.read_bytes()[:-40])
    assert "damaged    the file ends without its footer" in describe_log(survey_log(path))
    path.write_bytes(path.read_bytes()[:60])
    assert "the file holds no message" in describe_log(survey_log(path))


def test_names_that_would_clash_carry_their_topic(tmp_path: Path) -> None:
    film, path = take(), tmp_path / "log.mcap"
    numbers = [(f"/{side}", START_NS + i, {"x": float(i)}) for i in range(3) for side in ("left", "right")]
    by_json(path, [*json_take(film)[:12], *numbers])
    chosen = compose(*suggest_overrides(survey_log(path))).recording.mcap
    assert chosen is not None
    assert [each.name for each in chosen.inputs] == ["left_x", "right_x"]
    assert chosen.clock == "log"  # the numbers carry no stamp


def test_a_log_without_pictures_has_no_recording(tmp_path: Path) -> None:
    by_json(tmp_path / "log.mcap", json_take(take())[12:])
    told = describe_log(survey_log(tmp_path / "log.mcap"))
    assert "there is no recording in this file" in told


def test_a_message_that_cannot_be_decoded_is_told(tmp_path: Path) -> None:
    path, film = tmp_path / "log.mcap", take()
    by_rosbags(path, film)
    content = path.read_bytes()
    assert content.count(b"ros2msg") > 1
    path.write_bytes(content.replace(b"ros2msg", b"ros2idx"))
    told = describe_log(survey_log(path))
    assert "with a schema in 'ros2idx'; those read are ROS 2 CDR" in told
