"""Read a trajectory from the numbers in a log: joints as coordinates, efforts or commands as inputs.

A column is a topic and a path inside its messages, ``/joint_states.position[elbow]``. Where none is named,
the log's one topic of ``JointState`` gives positions, velocities and efforts. The samples are the messages of
the first coordinate; numbers of other topics are interpolated linearly to them, and nothing is extrapolated
(`lagsplat.io.recording.alignment`).
"""

import difflib
import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lagsplat.io.config import CLOCKS
from lagsplat.io.files.atomic import StrPath
from lagsplat.io.recording.alignment import AlignmentTerms, InputLog, align_log
from lagsplat.io.robot_log.messages import Decoders, read_field
from lagsplat.io.robot_log.storage import read_messages
from lagsplat.io.robot_log.topics import OF_TRAJECTORY, TopicLog, list_counts, missing_topic
from lagsplat.io.trajectory.columns import NUMBER, TIME
from lagsplat.io.trajectory.trajectory import LONGEST_LOSS, Trajectory

JOINT_STATE = "JointState"  # last name of the message type whose fields are positions, velocities, efforts
OF_JOINTS = (("q", "position"), ("v", "velocity"), ("u", "effort"))
TERMS = AlignmentTerms(
    "samples",
    "first coordinate",
    "diagnose.columns={t: log}",
    "record it without breaks of more than {:.3g} s",
)
Field = tuple[str, str]


@dataclass
class _Joints:
    """Joints of a topic in the order in which they are first named, and which fields give all of them."""

    names: list[str]
    fields: set[str]


def read_log_trajectory(path: StrPath, *, columns: Mapping[str, str] | None = None) -> Trajectory:
    """Read the trajectory in the MCAP file or bag at ``path``.

    ``columns`` maps ``q0, ..., v0, ..., u0, ...`` to numbers of the log, ``TOPIC.FIELD``, and ``t`` to the
    clock, ``header`` or ``log``; left out, it is the headers' where all topics in use have them. Coordinates
    and rates that are not named are those of the topic of ``JointState``; so are inputs, if no coordinate is
    named either and an effort changes.

    Times count from the first sample [s]. A gap of more than `LONGEST_LOSS` median steps of the slowest topic
    in use cuts the trajectory.

    Raises:
        FileNotFoundError: nothing is at ``path``.
        ValueError: the file is no log, a name, topic or field is not there or not a number, no single topic
            of ``JointState`` gives the coordinates, or a clock jumps back.
    """
    path, given = Path(path), dict(columns or {})
    clock = given.pop(TIME, None)
    if clock not in (None, *CLOCKS):
        raise ValueError(f"{path}: t is {clock!r}; the clocks of a log are {' and '.join(CLOCKS)}")
    fields = _choose_fields(path, given)
    log = TopicLog(path, list(dict.fromkeys(fields.values())), OF_TRAJECTORY, clock=clock)
    log.read()
    samples = {name: log.samples(*field) for name, field in fields.items()}
    leading_ns = samples["q0"][0]
    if len(leading_ns) < 2:
        what = f"{'.'.join(fields['q0'])} has {len(leading_ns)} number(s)"
        raise ValueError(f"{path}: {what}; a motion needs two or more")
    logs = [InputLog(name, (ns - leading_ns[0]) / 1e9, values) for name, (ns, values) in samples.items()]
    logs = logs if given else _drop_constant_efforts(path, logs)
    steps_s = [float(np.median(np.diff(each.time_s))) for each in logs if len(each.time_s) > 1]
    leading_s = (leading_ns - leading_ns[0]) / 1e9
    max_gap_s = LONGEST_LOSS * max(steps_s)
    aligned = align_log(leading_s, logs, max_gap_s=max_gap_s, source=str(path), terms=TERMS)
    places = {letter: [i for i, each in enumerate(logs) if each.name[0] == letter] for letter in "qvu"}
    q, v, u = (aligned.inputs[:, places[letter]] for letter in "qvu")
    return Trajectory(
        time_s=leading_s[aligned.kept],
        q=q,
        u=u,
        v=v if v.shape[1] else None,
        segments=aligned.segments,
        q_names=tuple(logs[i].name for i in places["q"]),
        u_names=tuple(logs[i].name for i in places["u"]),
        source=path.name,
    )


def _drop_constant_efforts(path: Path, logs: list[InputLog]) -> list[InputLog]:
    """Drop the efforts if none of them changes: where a driver measures none, it sends zeros."""
    efforts = [each for each in logs if each.name[0] == "u"]
    if not efforts or any(np.ptp(each.values) > 0.0 for each in efforts if len(each.values)):
        return logs
    commands = "diagnose.columns={u0: TOPIC.FIELD} makes a command an input"
    warnings.warn(f"{path}: no effort changes, so none is an input; {commands}", stacklevel=3)
    return [each for each in logs if each.name[0] != "u"]


def _choose_fields(path: Path, given: Mapping[str, str]) -> dict[str, Field]:
    """The topic and the path of each column, in the order of their names."""
    unknown = [name for name in given if not re.fullmatch(f"[qvu]{NUMBER}", name)]
    if unknown:
        known = "q0, ..., v0, ..., u0, ... and t are known"
        raise ValueError(f"{path}: diagnose.columns names {unknown[0]!r}; for a log {known}")
    letters = {name[0] for name in given}
    needs_joints = "q" not in letters
    counts, joints = _list_topics(path, with_joints=needs_joints)
    fields = {name: _split_column(path, name, text, counts) for name, text in given.items()}
    if needs_joints:
        wanted = [pair for pair in OF_JOINTS if pair[0] not in letters and not (pair[0] == "u" and letters)]
        fields |= _fields_of_joints(path, wanted, counts, joints)
    named = {letter: sorted((name for name in fields if name[0] == letter), key=_number) for letter in "qvu"}
    for letter, names in named.items():
        wanted_names = [f"{letter}{i}" for i in range(len(named["q"] if letter == "v" and names else names))]
        if names != wanted_names:
            raise ValueError(f"{path}: columns {names}, but {wanted_names} are needed, without holes")
    return {name: fields[name] for letter in "qvu" for name in named[letter]}


def is_joint_state(schema_name: str) -> bool:
    """Whether messages of this schema list joints, as those of ``sensor_msgs/msg/JointState`` do."""
    return re.search(rf"\b{JOINT_STATE}$", schema_name) is not None


def _number(name: str) -> int:
    return int(name[1:])


def _list_topics(path: Path, *, with_joints: bool) -> tuple[dict[str, int], dict[str, _Joints]]:
    """The number of messages by topic and, if asked for, the joints of each topic of joint states."""
    decoders, counts, joints = Decoders(), dict[str, int](), dict[str, _Joints]()
    for schema, channel, message in read_messages(path, []):
        topic = channel.topic
        counts[topic] = counts.get(topic, 0) + 1
        if not with_joints or schema is None or not is_joint_state(schema.name):
            continue
        try:
            decoded = decoders.decode(schema, channel, message)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from error
        known = joints.setdefault(topic, _Joints([], {field for _, field in OF_JOINTS}))
        names = read_field(decoded, "name")
        if isinstance(names, str) or not isinstance(names, Sequence):
            continue  # another message of this name, such as Foxglove's of a single joint
        known.names += [name for name in names if name not in known.names]
        known.fields -= {
            field for field in known.fields if len(read_field(decoded, field) or ()) != len(names)
        }
    return counts, joints


def _fields_of_joints(
    path: Path, wanted: Iterable[tuple[str, str]], counts: dict[str, int], joints: dict[str, _Joints]
) -> dict[str, Field]:
    usable = [topic for topic, found in joints.items() if found.names and "position" in found.fields]
    if len(usable) != 1:
        found = f"{len(usable)} topics of {JOINT_STATE} with named positions ({', '.join(usable) or 'none'})"
        raise ValueError(
            f"{path}: {found}, where one would give the coordinates; topics with messages: "
            f"{list_counts(counts)}. Set {OF_TRAJECTORY.topics}; `lagsplat inspect {path}` lists the numbers"
        )
    (topic,) = usable
    return {
        f"{letter}{i}": (topic, f"{field}[{name}]")
        for letter, field in wanted
        if field in joints[topic].fields
        for i, name in enumerate(joints[topic].names)
    }


def _split_column(path: Path, name: str, text: str, counts: dict[str, int]) -> Field:
    """The topic and the path of a number, of ``TOPIC.FIELD``."""
    topics = [topic for topic in counts if text.startswith(f"{topic}.")]
    if not topics:
        topic, point, _ = text.partition(".")
        if not point:
            near = difflib.get_close_matches(text, counts, n=1)
            example = f"{near[0] if near else 'TOPIC'}.FIELD"
            raise ValueError(
                f"{path}: diagnose.columns gives {name} as {text!r}; write a topic and a number in its "
                f"messages, {example}, as `lagsplat inspect {path}` lists them"
            )
        raise ValueError(f"{path}: {missing_topic(topic, counts)}. Set {OF_TRAJECTORY.topics}")
    topic = max(topics, key=len)
    return topic, text[len(topic) + 1 :]
