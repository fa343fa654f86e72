"""Messages whose definition is missing in the log, written as IDL, or unknown."""

import sys
from pathlib import Path

import numpy as np
import pytest
from mcap.records import Schema
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from lagsplat.io.robot_log.definitions import complete_definition
from lagsplat.io.robot_log.survey import survey_log
from lagsplat.io.robot_log.trajectory import read_log_trajectory
from lagsplat.report.inspection.log import describe_log
from tests.unit.io.robot_log.bag_files import (
    STORE,
    arm,
    camera_rows,
    command_rows,
    drop_definitions,
    joint_rows,
    write_bag,
)
from tests.unit.io.robot_log.mcap_files import START_NS, take

OWN = "arm_msgs/msg/Load"
IDL = """module arm_msgs { module msg { struct Load {
  @verbatim (language="comment", text="N") double force; sequence<double, 3> more; }; }; };
"""


def test_a_bag_without_definitions_is_read_by_those_of_humble(tmp_path: Path) -> None:
    of = arm()
    rows = [*joint_rows(of), *command_rows(of), *camera_rows(take())]
    bag = write_bag(tmp_path / "bag", rows, "sqlite3")
    before = describe_log(survey_log(bag))
    drop_definitions(bag)
    assert describe_log(survey_log(bag)) == before
    np.testing.assert_array_equal(read_log_trajectory(bag).q[:, ::-1], of.q)


def test_a_type_of_ones_own_needs_its_definition(tmp_path: Path) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg("float64 force\n", OWN))
    load = store.types[OWN]
    rows = [*joint_rows(arm(20)), *(("/load", OWN, 10_000_000 * i, load(float(i))) for i in range(21))]
    bag = write_bag(tmp_path / "bag", rows, "sqlite3", store=store)
    columns = {"u0": "/load.force"}
    at_s = read_log_trajectory(bag, columns={"t": "log", **columns})
    assert at_s.u[:, 0] == pytest.approx(100.0 * (at_s.time_s + arm(20).ns[0] / 1e9))
    drop_definitions(bag)
    told = describe_log(survey_log(bag))
    assert f"unreadable topic /load: the message logged at {START_NS} ns cannot be decoded: " in told
    with pytest.raises(ValueError, match=r"bag: topic /load: .*arm_msgs/msg/Load is unknown: the log has no"):
        read_log_trajectory(bag, columns=columns)
    assert read_log_trajectory(bag).d == 2  # topics that are not used need none


def test_idl_becomes_the_form_that_is_decoded() -> None:
    border = "=" * 80 + "\n"
    whole = f"{border}IDL: arm_msgs/msg/Load\n{IDL}".encode()
    found = complete_definition(Schema(1, whole, "ros2idl", OWN))
    assert found.encoding == "ros2msg"
    assert found.data.decode().splitlines()[:2] == ["float64 force", "float64[<=3] more"]
    bare = complete_definition(Schema(1, IDL.encode(), "ros2idl", OWN))
    assert bare.data == found.data
    with pytest.raises(ValueError, match="its definition cannot be read"):
        complete_definition(Schema(1, b"module {", "ros2idl", OWN))
    assert OWN not in STORE.fielddefs


def test_definitions_that_are_there_are_kept_and_need_no_library(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rosbags.typesys", None)
    given = Schema(1, b"float64 force\n", "ros2msg", OWN)
    assert complete_definition(given) is given
    with pytest.raises(ValueError, match=r"nowhere, as in bags before ROS 2 Iron.*lagsplat\[ros\]"):
        complete_definition(Schema(1, b"", "", OWN))
    with pytest.raises(ValueError, match=r"Load as IDL.*lagsplat\[ros\]"):
        complete_definition(Schema(1, b"x", "ros2idl", OWN))
