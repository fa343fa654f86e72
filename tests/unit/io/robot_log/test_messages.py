"""Fields and stamps are found alike in ROS 2, protobuf and JSON messages."""

from pathlib import Path
from typing import Any

import pytest

from lagsplat.io.robot_log.messages import Decoders, list_number_paths, read_number, read_stamp_ns
from lagsplat.io.robot_log.recovery import read_whole_messages
from tests.unit.io.robot_log.mcap_files import NAMES, START_NS, WRITERS, take

WRENCH = {
    "header": {"stamp": {"sec": 3, "nanosec": 5}, "frame_id": "f"},
    "wrench": {"force": {"x": 1.5, "y": 2}, "on": True, "unit": "N"},
    "data": [7, 8.5],
    "name": ["a", "b"],
    "effort": [0.25, 0.5],
    "left-arm": {"p": 4},
}


@pytest.fixture(scope="module", params=["rosbags", "foxglove"])
def joints(request: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Any]:
    path: Path = tmp_path_factory.mktemp("log") / "log.mcap"
    WRITERS[request.param](path, take())
    decoders = Decoders()
    for schema, channel, message in read_whole_messages(path, []):
        if channel.topic == "/joints":
            return request.param, decoders.decode(schema, channel, message)
    raise AssertionError


def test_a_joint_is_found_by_name_and_by_number(joints: tuple[str, Any]) -> None:
    writer, message = joints
    film = take()
    by_name = {"rosbags": "position[{}]", "foxglove": "joints[{}].position"}[writer]
    order = {"rosbags": NAMES[::-1], "foxglove": NAMES}[writer]
    for i, name in enumerate(NAMES):
        assert read_number(message, by_name.format(name)) == film.angles[0, i]
        assert read_number(message, by_name.format(order.index(name))) == film.angles[0, i]
    assert read_stamp_ns(message) == START_NS + film.joint_ns[0]
    known = list(list_number_paths(message))
    assert by_name.format("elbow") in known
    for path in known:
        assert isinstance(read_number(message, path), float)
    assert not any("sec" in path for path in known)
    with pytest.raises(ValueError, match=f"numbers are .*{NAMES[1]}"):
        read_number(message, by_name.format("knee"))


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("wrench.force.x", 1.5),
        ("wrench.force.y", 2.0),
        ("wrench.on", 1.0),
        ("data[1]", 8.5),
        ("effort[b]", 0.5),
        ("effort[0]", 0.25),
        ("left-arm.p", 4.0),
    ],
)
def test_numbers_in_json(path: str, value: float) -> None:
    assert read_number(WRENCH, path) == value


@pytest.mark.parametrize(
    "path", ["wrench", "wrench.force.z", "data", "data[2]", "effort[c]", "wrench.unit", "x", "wrench[0]"]
)
def test_what_is_no_number_is_told_with_what_is(path: str) -> None:
    with pytest.raises(ValueError, match=r"is no number; numbers are wrench\.force\.x, wrench\.force\.y"):
        read_number(WRENCH, path)


def test_a_key_with_dots_is_a_name_too() -> None:
    assert read_number({"p.1[0]": 2.0}, "p.1[0]") == 2.0
    assert read_number({"data": b"\x01\x02"}, "data[1]") == 2.0


@pytest.mark.parametrize(
    ("message", "stamp"),
    [
        (WRENCH, 3 * 10**9 + 5),
        ({"timestamp": {"sec": 1, "nsec": 2}}, 10**9 + 2),
        ({"timestamp": {"seconds": 1, "nanos": 2}}, 10**9 + 2),
        ({"stamp": {"sec": 0, "nanosec": 9}}, 9),
        ({"timestamp": 4.5}, None),
        ({"x": 1.0}, None),
        (3.0, None),
    ],
)
def test_stamps(message: Any, stamp: int | None) -> None:
    assert read_stamp_ns(message) == stamp


def test_an_unset_protobuf_stamp_is_none() -> None:
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

    image = CompressedImage()
    assert read_stamp_ns(image) is None
    image.timestamp.FromNanoseconds(17)
    assert read_stamp_ns(image) == 17
