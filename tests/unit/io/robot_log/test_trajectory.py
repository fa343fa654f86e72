"""Trajectories from the numbers of a log: joints, efforts and commands, by name, on either clock."""

import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import lagsplat
from lagsplat.cli.main import main
from lagsplat.config.compose import compose
from lagsplat.io.robot_log.survey import survey_log
from lagsplat.io.robot_log.trajectory import read_log_trajectory
from lagsplat.report.inspection.log import describe_log, suggest_columns
from tests.unit.io.robot_log.bag_files import (
    JOINT,
    STORAGES,
    STORE,
    arm,
    camera_rows,
    command_rows,
    header,
    joint_rows,
    write_bag,
)
from tests.unit.io.robot_log.mcap_files import START_NS, by_json, take

both = pytest.mark.parametrize("storage", STORAGES)
BY_NAME = {f"q{i}": f"/joint_states.position[{name}]" for i, name in enumerate(("shoulder", "elbow"))}
COMMANDS = {f"u{i}": f"/arm/command.data[{i}]" for i in range(2)}


@both
def test_joint_states_give_coordinates_rates_and_efforts(tmp_path: Path, storage: str) -> None:
    of = arm()
    bag = write_bag(tmp_path / "bag", joint_rows(of), storage)
    motion = lagsplat.read_trajectory(bag)
    np.testing.assert_allclose(motion.time_s, (of.ns - of.ns[0]) / 1e9, atol=1e-12)
    # in the order in which the driver lists the joints
    np.testing.assert_array_equal(motion.q, of.q[:, ::-1])
    np.testing.assert_array_equal(motion.v, of.v[:, ::-1])
    np.testing.assert_array_equal(motion.u, of.effort[:, ::-1])
    assert (motion.q_names, motion.u_names, motion.source) == (("q0", "q1"), ("u0", "u1"), "bag")
    assert motion.segments == ((0, 200),)


@both
def test_named_numbers_of_several_topics_are_joined(tmp_path: Path, storage: str) -> None:
    of = arm()
    bag = write_bag(tmp_path / "bag", [*joint_rows(of), *command_rows(of)], storage)
    motion = lagsplat.read_trajectory(bag, columns={**BY_NAME, **COMMANDS})
    np.testing.assert_array_equal(motion.q, of.q)
    assert motion.v is None
    expected = [np.interp(of.ns, of.command_ns, column) for column in of.command.T]
    np.testing.assert_allclose(motion.u, np.stack(expected, axis=1), atol=1e-12)
    some = lagsplat.read_trajectory(bag, columns=COMMANDS)  # coordinates as without columns
    np.testing.assert_array_equal(some.q, of.q[:, ::-1])
    np.testing.assert_array_equal(some.u, motion.u)
    assert some.v is not None


def test_the_clock_is_one_for_all_topics(tmp_path: Path) -> None:
    of = arm()
    late = [(topic, kind, ns + 5_000_000, message) for topic, kind, ns, message in joint_rows(of)]
    bag = write_bag(tmp_path / "bag", [*late, *command_rows(of)], "sqlite3")
    by_log = lagsplat.read_trajectory(bag, columns={**BY_NAME, **COMMANDS})  # commands have no stamp
    expected = np.interp(of.ns + 5_000_000, of.command_ns, of.command[:, 1])
    np.testing.assert_allclose(by_log.u[:, 1], expected, atol=1e-12)
    with pytest.raises(
        ValueError, match=r"/arm/command: message 0 has no stamp; use diagnose.columns={t: log}"
    ):
        lagsplat.read_trajectory(bag, columns={**BY_NAME, **COMMANDS, "t": "header"})
    with pytest.raises(ValueError, match=r"t is 'clock'; the clocks of a log are header and log"):
        lagsplat.read_trajectory(bag, columns={"t": "clock"})


def test_efforts_that_never_change_are_no_inputs(tmp_path: Path) -> None:
    still = replace(arm(), effort=np.zeros((200, 2)))
    bag = write_bag(tmp_path / "bag", joint_rows(still), "mcap")
    with pytest.warns(UserWarning, match="no effort changes, so none is an input"):
        assert lagsplat.read_trajectory(bag).n_u == 0
    without = write_bag(tmp_path / "without", joint_rows(still, efforts=False), "mcap")
    assert lagsplat.read_trajectory(without).n_u == 0


def test_two_nodes_on_one_topic_give_the_joints_that_are_named(tmp_path: Path) -> None:
    of, none = arm(), np.zeros(0)
    gripper = [
        (
            "/joint_states",
            JOINT,
            int(ns) + 1,
            STORE.types[JOINT](header(ns + START_NS + 1), ["finger"], q[:1], none, none),
        )
        for ns, q in zip(of.ns[::4], of.q[::4], strict=True)
    ]
    bag = write_bag(tmp_path / "bag", [*joint_rows(of), *gripper], "sqlite3")
    with pytest.warns(
        UserWarning, match=r"50 of 250 messages give no number, as topic /joint_states, message"
    ):
        motion = lagsplat.read_trajectory(bag, columns=BY_NAME)
    np.testing.assert_array_equal(motion.q, of.q)


def test_a_break_cuts_the_trajectory(tmp_path: Path) -> None:
    of = arm()
    rows = [row for row in joint_rows(of) if not 50 <= row[2] // 10_000_000 < 60]
    motion = lagsplat.read_trajectory(write_bag(tmp_path / "bag", rows, "sqlite3"))
    assert motion.segments == ((0, 50), (50, 190))


def test_what_is_not_there_is_named(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", [*joint_rows(arm()), *command_rows(arm())], "sqlite3")
    cases = {
        "q0": (
            "/joint_state.position[elbow]",
            r"no message on topic '/joint_state' \(did you mean '/joint_st",
        ),
        "q1": ("/joint_states.position[elbow]", r"columns \['q1'\], but \['q0'\] are needed"),
        "u0": (
            "/arm/command.data[7]",
            r"/arm/command, message 0: field 'data\[7\]' is no number; numbers are",
        ),
        "u1": ("/arm/comand", r"write a topic and a number in its messages, /arm/command\.FIELD"),
        "w0": ("/arm/command.data[0]", "diagnose.columns names 'w0'; for a log q0"),
    }
    for name, (column, message) in cases.items():
        with pytest.raises(ValueError, match=message):
            read_log_trajectory(bag, columns={name: column})
    two = [*joint_rows(arm()), *joint_rows(arm(), topic="/other")]
    several = write_bag(tmp_path / "several", two, "sqlite3")
    with pytest.raises(
        ValueError, match=r"2 topics of JointState with named positions \(/joint_states, /other\)"
    ):
        read_log_trajectory(several)
    by_json(tmp_path / "numbers.mcap", [("/x", START_NS + i, {"a": 1.0 * i}) for i in range(3)])
    with pytest.raises(ValueError, match=r"0 topics of JointState .*/x \(3\).*lagsplat inspect"):
        read_log_trajectory(tmp_path / "numbers.mcap")
    numbers = read_log_trajectory(tmp_path / "numbers.mcap", columns={"q0": "/x.a"})
    assert numbers.q[:, 0].tolist() == [0.0, 1.0, 2.0]
    by_json(tmp_path / "one.mcap", [("/x", START_NS, {"a": 1.0})])
    with pytest.raises(ValueError, match=r"/x\.a has 1 number"):
        read_log_trajectory(tmp_path / "one.mcap", columns={"q0": "/x.a"})


@both
def test_what_inspect_suggests_can_be_typed_and_read(
    tmp_path: Path, storage: str, capsys: pytest.CaptureFixture[str]
) -> None:
    of = arm()
    bag = write_bag(tmp_path / "a bag", [*joint_rows(of), *command_rows(of), *camera_rows(take())], storage)
    assert main(["inspect", str(bag)]) == 0
    told = capsys.readouterr().out
    rate_hz = 199 / ((of.ns[-1] - of.ns[0]) / 1e9)
    assert f"{JOINT}, cdr: 200 messages, {rate_hz:.3f} Hz" in told
    assert "recording.mcap.camera=/camera" in told
    block = told[told.index("lagsplat diagnose") :].replace("\\\n", " ").partition("\n")[0]
    *_, real, columns = shlex.split(block)
    assert real == f"real={bag}"
    chosen = compose(columns).diagnose.columns
    assert chosen == suggest_columns(survey_log(bag))
    assert list(chosen) == ["q0", "q1", "v0", "v1", "u0", "u1"]
    motion = lagsplat.read_trajectory(bag, columns=chosen)
    np.testing.assert_array_equal(motion.q, of.q[:, ::-1])
    assert motion.u[100, 0] == pytest.approx(np.interp(of.ns[100], of.command_ns, of.command[:, 0]))


def test_without_commands_efforts_are_suggested(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", joint_rows(arm()), "mcap")
    columns = suggest_columns(survey_log(bag))
    assert columns["u1"] == "/joint_states.effort[shoulder]"
    assert "there is no recording in this file" in describe_log(survey_log(bag))
