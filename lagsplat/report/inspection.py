"""What a file holds, in words, before anything is trained on it: a recording, a robot's log, a video.

For a log and a video the text ends with the overrides or the configuration that follow from it.
"""

import re
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.free_motion import find_free_segments
from lagsplat.evaluate.protocol import HeldOut
from lagsplat.io.config import RecordingConfig
from lagsplat.io.recording.recording import Recording
from lagsplat.io.robot_log.survey import LogSurvey, TopicSummary
from lagsplat.io.robot_log.trajectory import is_joint_state
from lagsplat.io.video.proposal import IMAGE_MODEL, propose_settings

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
GAP_RATIO = 1.5  # a spacing above this many medians is a gap
MAX_LISTED = 5


def describe_recording(recording: Recording, *, config: EvaluateConfig) -> str:
    """Describe origin, size, clock, inputs, gaps, free segments and split, a line each.

    A gap is a spacing of more than 1.5 medians within a clip. Free segments are those of the whole recording,
    by the same rule as the evaluation's.

    Raises:
        ValueError: the recording is not divided.
    """
    train, held_out = recording.split()
    duration_s = recording.time_s[-1] - recording.time_s[0]
    columns = zip(recording.input_names, recording.input_units, recording.inputs.T, strict=True)
    inputs = [
        f"input {name:<4} {values.min():.4g} to {values.max():.4g} {unit}, mean {values.mean():.4g}"
        for name, unit, values in columns
    ]
    lines = [
        f"source     {recording.meta.get('source')} ({recording.meta.get('origin')})",
        f"licence    {recording.meta.get('licence')}",
        f"frames     {recording.n_frames}, {recording.width} x {recording.height} px, "
        f"{len(recording.segments)} clip(s)",
        f"duration   {duration_s:.3f} s, {1.0 / recording.dt_s:.4f} frames/s, spacing {recording.dt_s:.6f} s",
        f"colours    {_describe_colours(recording)}",
        *(inputs or ["inputs     none"]),
        f"gaps       {_describe_gaps(recording)}",
        f"free       {_describe_free(recording, config)}",
        f"split      {train.n_frames} frames to train on, {held_out.n_frames} held out",
    ]
    return "\n".join(lines)


def _describe_colours(recording: Recording) -> str:
    frames = np.asarray(recording.frames[:: max(1, recording.n_frames // 200)])
    moving = frames.astype(np.float32).std(axis=0).max() / 255.0
    return f"{frames.min()} to {frames.max()} of 255; the busiest pixel varies by {moving:.3f} (rms, of 1)"


def _describe_gaps(recording: Recording) -> str:
    gaps = []
    for start, stop in recording.segments:
        for frame, step in enumerate(np.diff(recording.time_s[start:stop]), start=start):
            if step > GAP_RATIO * recording.dt_s:
                gaps.append(f"{step:.3f} s after frame {frame}")
    more = f" and {len(gaps) - MAX_LISTED} more" if len(gaps) > MAX_LISTED else ""
    return ", ".join(gaps[:MAX_LISTED]) + more if gaps else "none"


def _describe_free(recording: Recording, config: EvaluateConfig) -> str:
    still, inputs = np.zeros((recording.n_frames, 1)), recording.inputs
    clips, dt_s = recording.segments, recording.dt_s
    whole = HeldOut(still, still, inputs, inputs, clips, metric=np.eye(1), dt_s=dt_s, skip=0)
    segments = [
        f"frames {start} to {stop} ({(stop - start) * recording.dt_s:.1f} s)"
        for start, stop in find_free_segments(whole, config)[:MAX_LISTED]
    ]
    return ", ".join(segments) or f"no stretch of {config.free_min_s:g} s without a change of input"


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
    names = [_make_name(path) for _, path in fields]
    inputs = []
    for (topic, path), name in zip(fields, names, strict=True):
        parts: list[str] = re.findall(r"[^.\[\]]+", path)
        values = {
            "topic": topic.name,
            "field": path,
            "name": name if names.count(name) == 1 else _make_name(f"{topic.name}.{path}"),
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
    pairs = ", ".join(f"{name}: {quote(column)}" for name, column in columns.items())
    return [
        f"as motion  lagsplat diagnose sim=SIM {shlex.quote(f'real={survey.path}')} \\",
        f"           {shlex.quote(f'diagnose.columns={{{pairs}}}')}",
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


def _make_name(path: str) -> str:
    return re.sub(r"\W+", "_", path).strip("_")


def quote(text: str) -> str:
    """Quote a value as the grammar of Hydra requires: brackets and spaces need quotes."""
    plain = re.fullmatch(r"[\w/.-]+( [\w/.-]+)*", text, re.ASCII)
    return text if plain else '"' + text.replace('"', '\\"') + '"'


def describe_video(recording: Recording) -> str:
    """Describe the quality of a video, ``recording.meta["footage"]``, with a block of lines for each clip."""
    lines = []
    for clip, quality in zip(recording.meta["clips"], recording.meta["footage"], strict=True):
        if len(recording.meta["clips"]) > 1:
            lines.append(f"clip       {clip['source']}, {clip['frames']} frames")
        lines += _describe_quality(quality)
        lines += [f"warning    {sentence}" for sentence in quality["warnings"]]
    return "\n".join(lines)


def propose_system(recording: Recording, *, path: Path, settings: RecordingConfig) -> str:
    """Propose a ``conf/system/NAME.yaml`` for this recording; only ``d`` is left to its user."""
    name = _make_name(path.stem).lower() or "film"
    proposed, split = propose_settings(recording, settings), settings.split
    model = "\n".join(f"  {key}: {value}" for key, value in IMAGE_MODEL.items())
    crop = "null" if settings.crop is None else str(list(settings.crop))
    images = "" if settings.dt_s is None else f"\n  dt_s: {settings.dt_s:g}"
    return f"""
# @package _global_
# To be kept as conf/system/{name}.yaml, then: lagsplat fit system={name} out=FOLDER
defaults:
  - override /recording: filmed
  - override /simulation: null

system:
  title: {name.replace("_", " ")}
  film: video
  d: 1 # its number of degrees of freedom, which only you know
{model}

simulation: null

recording:
  path: {str(path)!r}{images} # spacing of frames: {recording.dt_s:.6g} s
  rotate: {settings.rotate}
  stabilise: {str(proposed.stabilise).lower()}
  grey: {str(settings.grey).lower()}
  crop: {crop} # x, y, width, height, tight around the motion
  skip_s: {proposed.skip_s:g}
  end_s: {_format_optional(proposed.end_s)}
  height: {proposed.height}
  width: {proposed.width}
  split:
    train_fraction: {_format_optional(split.train_fraction)}
    held_out_frames: {_format_optional(split.held_out_frames)}
    held_out_clips: {_format_optional(split.held_out_clips)}

chart:
  smoothing_frames: {proposed.smoothing_frames:g} # a twentieth of a period"""


def _format_optional(value: float | None) -> str:
    return "null" if value is None else f"{value:g}"


def _describe_quality(quality: Mapping[str, Any]) -> list[str]:
    camera, flicker, sampling = quality["camera"], quality["flicker"], quality["sampling"]
    texts = {
        "camera": "not measured: too little stands still, or too few frames",
        "exposure": "not measured",
        "period": "not measured",
        "cuts": ", ".join(f"{cut['time_s']:.3f} s" for cut in quality["cuts"]) or "none",
    }
    if camera is not None:
        texts["camera"] = (
            f"moves {camera['rms_px']:.2f} px rms, {camera['max_px']:.2f} px at most (drift "
            f"{camera['drift_px']:.2f}, jitter {camera['jitter_px']:.2f}); limit "
            f"{quality['camera_limit_px']:.2f} px rms of the film"
        )
    if flicker is not None:
        texts["exposure"] = f"{flicker['rms_percent']:.2f} % rms, mostly at {flicker['frequency_hz']:.2f} Hz"
    if sampling is not None:
        texts["period"] = f"{sampling['period_s']:.4g} s, {sampling['samples']:.1f} frames each"
    return [f"{name:<11}{text}" for name, text in texts.items()]
