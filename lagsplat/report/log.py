"""What an MCAP file holds, in words, and how to make a recording of it."""

import re
import shlex
from collections.abc import Sequence

from lagsplat.io.mcap_topics import Survey, Topic

MOST_INPUTS = 8
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


def describe_log(survey: Survey) -> str:
    """Topics with type, encoding, count, rate, longest gap and time; what is wrong; and what to type.

    Times count from the first message logged in the file.
    """
    times = [ns for topic in survey.topics for ns in (min(topic.log_ns), max(topic.log_ns))]
    lines = [f"source     {survey.path.name}"]
    if not times:
        return "\n".join([*lines, "topics     none: the file holds no message", *_warnings(survey)])
    start = min(times)
    lines.append(f"duration   {(max(times) - start) / 1e9:.3f} s, from {start / 1e9:.6f} s (log time)")
    for topic in survey.topics:
        lines += _topic(topic, start)
    return "\n".join([*lines, *_warnings(survey), *_advice(survey)])


def _topic(topic: Topic, start_ns: int) -> list[str]:
    rate = "" if topic.rate_hz is None else f", {topic.rate_hz:.3f} Hz"
    first, last = ((ns - start_ns) / 1e9 for ns in (min(topic.log_ns), max(topic.log_ns)))
    lines = [
        f"topic      {topic.name}",
        f"           {topic.schema or '(no schema)'}, {topic.encoding}: {len(topic.log_ns)} messages{rate}, "
        f"longest gap {topic.longest_gap_s:.3f} s, from {first:.3f} s to {last:.3f} s",
    ]
    if topic.numbers:
        shown = ", ".join(topic.numbers[:MOST_INPUTS])
        lines.append(f"           numbers: {shown}{', ...' if len(topic.numbers) > MOST_INPUTS else ''}")
    return lines


def _warnings(survey: Survey) -> list[str]:
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


def _advice(survey: Survey) -> list[str]:
    words = suggested(survey)
    if not words:
        return ["to use it  no topic holds pictures that can be read, so there is no recording in this file"]
    varying = sum(len(topic.moving) for topic in survey.topics)
    lines = [
        "to use it  lagsplat fit out=FOLDER system=SYSTEM \\",
        *(f"           {shlex.quote(word)} \\" for word in words[:-1]),
        f"           {shlex.quote(words[-1])}",
        "           leave out inputs that do not drive the mechanism; units are those of ROS, or unknown",
    ]
    if varying > MOST_INPUTS:
        lines.append(f"           {varying} numbers vary; the first {MOST_INPUTS} are listed")
    return lines


def suggested(survey: Survey) -> list[str]:
    """Overrides that make a recording of the file: its busiest camera, and numbers that vary; none without a
    camera."""
    cameras = [topic for topic in survey.topics if topic.picture and not topic.problem]
    if not cameras:
        return []
    camera = max(cameras, key=lambda topic: len(topic.log_ns))
    driving = [topic for topic in survey.topics if topic.moving and not topic.problem]
    fields = [(topic, path) for topic in driving for path in topic.numbers if path in topic.moving][
        :MOST_INPUTS
    ]
    used = [camera, *(topic for topic, _ in fields)]
    stamped = all(topic.stamped and not topic.backwards["header"] for topic in used)
    names = [_name(path) for _, path in fields]
    inputs = ", ".join(
        _input(topic, path, name if names.count(name) == 1 else _name(f"{topic.name}.{path}"))
        for (topic, path), name in zip(fields, names, strict=True)
    )
    return [
        "recording=filmed",
        f"recording.path={_quoted(str(survey.path))}",
        "recording.kind=mcap",
        f"recording.mcap.camera={_quoted(camera.name)}",
        f"recording.mcap.clock={'header' if stamped else 'log'}",
        f"recording.mcap.inputs=[{inputs}]",
    ]


def _input(topic: Topic, path: str, name: str) -> str:
    values = {"topic": topic.name, "field": path, "name": name, "unit": _unit(path)}
    return "{" + ", ".join(f"{key}: {_quoted(value)}" for key, value in values.items()) + "}"


def _name(path: str) -> str:
    return re.sub(r"\W+", "_", path).strip("_")


def _quoted(text: str) -> str:
    """As Hydra's grammar wants it: brackets and spaces need quotes."""
    return (
        text
        if re.fullmatch(r"[\w/.-]+( [\w/.-]+)*", text, re.ASCII)
        else '"' + text.replace('"', '\\"') + '"'
    )


def _unit(path: str) -> str:
    parts: Sequence[str] = re.findall(r"[^.\[\]]+", path)
    return next((UNITS[part] for part in reversed(parts) if part in UNITS), "unknown")
