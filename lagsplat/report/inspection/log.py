"""What a robot's log holds, in words, and the commands that read it."""

import re
import shlex

from lagsplat.io.robot_log.survey import LogSurvey, TopicSummary
from lagsplat.io.robot_log.trajectory import is_joint_state
from lagsplat.report.inspection.words import make_name, quote, write_columns

MAX_INPUTS = 8
UNITS = {
    "position": "rad",
    "velocity": "rad/s",
    "effort": "N m",
    "force": "N",
    "torque": "N m",
    "fluid_pressure": "Pa",
    "temperature": "degC",
}
"""Units that ROS messages prescribe; a prismatic joint has m, m/s and N."""
COMMAND = re.compile("cmd|command|torque|effort|target|desired|goal|setpoint|ctrl|control", re.IGNORECASE)
"""What topics are called whose numbers drive a mechanism."""


def describe_log(survey: LogSurvey) -> str:
    """Describe the topics of a log, what is damaged, and the commands that read it.

    Times count from the first message logged in the file.
    """
    times = [ns for topic in survey.topics for ns in (min(topic.log_ns), max(topic.log_ns))]
    lines = [f"source     {survey.path.name}"]
    if not times:
        return "\n".join([*lines, "topics     none: the file holds no message", *_list_warnings(survey)])
    start = min(times)
    lines.append(f"duration   {(max(times) - start) / 1e9:.3f} s, from {start / 1e9:.6f} s (log time)")
    for topic in survey.topics:
        lines += _describe_topic(topic, start)
    return "\n".join([*lines, *_list_warnings(survey), *_list_advice(survey)])


def _describe_topic(topic: TopicSummary, start_ns: int) -> list[str]:
    rate = "" if topic.rate_hz is None else f", {topic.rate_hz:.3f} Hz"
    first, last = ((ns - start_ns) / 1e9 for ns in (min(topic.log_ns), max(topic.log_ns)))
    lines = [
        f"topic      {topic.name}",
        f"           {topic.schema or '(no schema)'}, {topic.encoding}: {len(topic.log_ns)} messages{rate}, "
        f"longest gap {topic.longest_gap_s:.3f} s, from {first:.3f} s to {last:.3f} s",
    ]
    if topic.numbers:
        shown = ", ".join(topic.numbers[:MAX_INPUTS])
        lines.append(f"           numbers: {shown}{', ...' if len(topic.numbers) > MAX_INPUTS else ''}")
    return lines


def _list_warnings(survey: LogSurvey) -> list[str]:
    lines = [f"damaged    {loss}" for loss in survey.losses]
    for topic in survey.topics:
        if topic.problem:
            lines.append(f"unreadable {topic.problem}")
        lines += [
            f"warning    {topic.name}: the {clock} clock jumps back {count} times"
            for clock, count in topic.backwards.items()
            if count
        ]
        if len(topic.header_ns) > 1 and None not in topic.header_ns and not topic.stamped:
            lines.append(f"warning    {topic.name}: all header stamps are the same; use the log clock")
    return lines


def _list_advice(survey: LogSurvey) -> list[str]:
    overrides = suggest_overrides(survey)
    lines = _list_columns(survey)
    if not overrides:
        return [
            "to use it  no topic holds pictures that can be read, so there is no recording in this file",
            *lines,
        ]
    varying = sum(len(topic.moving) for topic in survey.topics)
    lines += [
        "to use it  lagsplat fit out=FOLDER system=SYSTEM \\",
        *(f"           {shlex.quote(override)} \\" for override in overrides[:-1]),
        f"           {shlex.quote(overrides[-1])}",
        "           leave out inputs that do not drive the mechanism; units are those of ROS, or unknown",
    ]
    if varying > MAX_INPUTS:
        lines.append(f"           {varying} numbers vary; the first {MAX_INPUTS} are listed")
    return lines


def suggest_overrides(survey: LogSurvey) -> list[str]:
    """Suggest the overrides that make a recording of the file; none without a camera.

    They name the camera with the most frames and numbers that vary.
    """
    cameras = [topic for topic in survey.topics if topic.picture and not topic.problem]
    if not cameras:
        return []
    camera = max(cameras, key=lambda topic: len(topic.log_ns))
    driving = [topic for topic in survey.topics if topic.moving and not topic.problem]
    fields = [(topic, path) for topic in driving for path in topic.numbers if path in topic.moving]
    fields = fields[:MAX_INPUTS]
    used = [camera, *(topic for topic, _ in fields)]
    stamped = all(topic.stamped and not topic.backwards["header"] for topic in used)
    names = [make_name(path) for _, path in fields]
    inputs = []
    for (topic, path), name in zip(fields, names, strict=True):
        parts: list[str] = re.findall(r"[^.\[\]]+", path)
        values = {
            "topic": topic.name,
            "field": path,
            "name": name if names.count(name) == 1 else make_name(f"{topic.name}.{path}"),
            "unit": next((UNITS[part] for part in reversed(parts) if part in UNITS), "unknown"),
        }
        inputs.append("{" + ", ".join(f"{key}: {quote(value)}" for key, value in values.items()) + "}")
    return [
        "recording=filmed",
        f"recording.path={quote(str(survey.path))}",
        "recording.kind=mcap",
        f"recording.mcap.camera={quote(camera.name)}",
        f"recording.mcap.clock={'header' if stamped else 'log'}",
        f"recording.mcap.inputs=[{', '.join(inputs)}]",
    ]


def _list_columns(survey: LogSurvey) -> list[str]:
    columns = suggest_columns(survey)
    if not columns:
        return []
    return [
        f"as motion  lagsplat diagnose sim=SIM {shlex.quote(f'real={survey.path}')} \\",
        f"           {shlex.quote(write_columns(columns))}",
        "           in the order of the sim's coordinates and inputs; leave out what it has not",
    ]


def suggest_columns(survey: LogSurvey) -> dict[str, str]:
    """Suggest the columns of a trajectory; none without a topic of ``JointState`` with positions that vary.

    They are its positions, its velocities if there is one for each, and as inputs the numbers that vary of
    topics that are named as commands, or its efforts if there are no such topics.
    """
    readable = [topic for topic in survey.topics if not topic.problem]
    states = [topic for topic in readable if is_joint_state(topic.schema) and topic.moving]
    if not states:
        return {}
    state = max(states, key=lambda topic: len(topic.log_ns))
    of_field = {
        field: [f"{state.name}.{path}" for path in state.numbers if path.startswith(f"{field}[")]
        for field in ("position", "velocity", "effort")
    }
    q, v, u = of_field.values()
    commands = [
        f"{topic.name}.{path}"
        for topic in readable
        if topic is not state and COMMAND.search(topic.name)
        for path in topic.numbers
        if path in topic.moving
    ]
    moving = {f"{state.name}.{path}" for path in state.moving}
    inputs = commands[:MAX_INPUTS] or ([] if moving.isdisjoint(u) else u)
    columns = {"q": q, "v": v if len(v) == len(q) and not moving.isdisjoint(v) else [], "u": inputs}
    return {f"{letter}{i}": column for letter, named in columns.items() for i, column in enumerate(named)}
