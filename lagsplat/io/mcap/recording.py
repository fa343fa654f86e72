"""Read a recording from an MCAP log, or survey its topics: rates, gaps, clocks, images and numbers.

One camera topic gives the frames, and numbers of other topics are interpolated to them as inputs
(`lagsplat.io.recording.alignment`). Times count from the camera's first message. The intact part of a
damaged file is read, with a warning of what is lost.
"""

import difflib
import warnings
from contextlib import closing
from dataclasses import dataclass, field
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64

from lagsplat.io.config import McapConfig, McapInputConfig
from lagsplat.io.files.atomic import StrPath, sha256_of
from lagsplat.io.mcap import messages
from lagsplat.io.mcap.images import CameraReader, image_kind
from lagsplat.io.mcap.recovery import read_whole_messages
from lagsplat.io.recording.alignment import InputLog, align_log
from lagsplat.io.recording.recording import Recording
from lagsplat.video_quality.assessment import assess_video
from lagsplat.video_quality.frames import FrameSettings


def read_mcap(path: StrPath, topics: McapConfig, settings: FrameSettings) -> Recording:
    """Read the recording in the MCAP file at ``path``.

    Dropped, each with a warning that counts them: repeated stamps, images that cannot be decoded, numbers
    that are not finite, and frames outside the inputs or in a gap.

    Raises:
        FileNotFoundError: there is no file at ``path``.
        ValueError: the file is no MCAP; a topic is missing, empty or of another type; a field does not
            exist; a clock jumps backwards; an encoding or codec is unknown; camera and inputs do not
            overlap; or no frame is left.
    """
    path = Path(path)
    with closing(CameraReader(str(topics.camera), settings, source=str(path))) as camera:
        log = _Log(path, topics, camera)
        log.read()
    numbers, frame_s = log.frame_times()
    logs = [log.samples(each) for each in topics.inputs]
    aligned = align_log(frame_s, logs, max_gap_s=topics.max_gap_s, source=str(path))
    pictures = [camera.frames.pop(int(number)) for number in numbers[aligned.kept]]
    sizes = {picture.shape[:2] for picture in pictures}
    if len(sizes) > 1:
        problem = f"{path}: the camera's pictures have sizes {sorted(sizes)} (height, width)"
        raise ValueError(f"{problem}; give recording.height and recording.width")
    frames, time_s = np.stack(pictures), frame_s[aligned.kept]
    footage = assess_video(frames, time_s, camera.thumbnails, crop=settings.crop)
    for sentence in footage.warnings:
        warnings.warn(f"{path}: {sentence}", stacklevel=3)
    return Recording(
        frames=frames,
        time_s=time_s,
        inputs=aligned.inputs,
        input_names=tuple(each.name for each in topics.inputs),
        input_units=tuple(each.unit for each in topics.inputs),
        segments=aligned.segments,
        meta={
            "origin": "filmed",
            "source": path.name,
            "sha256": sha256_of(path),
            "licence": "unknown",
            "crop": None if settings.crop is None else list(settings.crop),
            "skip_s": settings.skip_s,
            "end_s": settings.end_s,
            "camera": camera.topic,
            "clock": topics.clock,
            "max_gap_s": topics.max_gap_s,
            "start_ns": camera.start_ns,
            "rotate": settings.rotate,
            "grey": settings.grey,
            "clips": [
                {
                    "source": path.name,
                    "frames": len(frames),
                    "start_s": float(time_s[0]),
                    "picture_px": [camera.thumbnails.height, camera.thumbnails.width],
                }
            ],
            "footage": [footage.numbers],
        },
    )


class _Log:
    """One pass over the file: images of the camera, and stamps and values of every topic in use."""

    def __init__(self, path: Path, topics: McapConfig, camera: CameraReader) -> None:
        self.path, self.clock, self.camera = path, topics.clock, camera
        used = [camera.topic, *(each.topic for each in topics.inputs)]
        self._stamps = {topic: messages.Timestamps(topic) for topic in used}
        fields = [(each.topic, each.field) for each in topics.inputs]
        self._values: dict[tuple[str, str], list[float]] = {field: [] for field in fields}

    def read(self) -> None:
        """Read the file once."""
        decoders, losses, last_ns = messages.Decoders(), list[str](), 0
        counts: dict[str, int] = {}
        for schema, channel, message in read_whole_messages(self.path, losses):
            counts[channel.topic] = counts.get(channel.topic, 0) + 1
            last_ns = max(last_ns, message.log_time)
            if channel.topic in self._stamps:
                try:
                    decoded = decoders.decode(schema, channel, message)
                    self._take(channel.topic, decoded, schema.name if schema else "", message.log_time)
                except ValueError as error:
                    raise ValueError(f"{self.path}: {error}") from error
        if losses:
            rest = f"{sum(counts.values())} messages are whole, the last one logged at {last_ns / 1e9:.3f} s"
            self._warn(f"damaged: {'; '.join(losses)}. {rest}")
        for topic in self._stamps:
            if topic not in counts:
                near = difflib.get_close_matches(topic, counts, n=1)
                hint = f" (did you mean {near[0]!r}?)" if near else ""
                listed = ", ".join(f"{name} ({count})" for name, count in sorted(counts.items())) or "none"
                raise ValueError(
                    f"{self.path}: no message on topic {topic!r}{hint}; topics with messages: {listed}. Set "
                    "recording.mcap.camera, or the topic in recording.mcap.inputs"
                )
        try:
            self.camera.finish()
        except ValueError as error:
            raise ValueError(f"{self.path}: topic {self.camera.topic}: {error}") from error
        if bad := self.camera.damaged:
            self._warn(f"{len(bad)} pictures cannot be decoded and are dropped; the first is {bad[0]}")
        self._times = {topic: self._choose_times(stamps) for topic, stamps in self._stamps.items()}

    def _take(self, topic: str, message: Any, schema_name: str, log_ns: int) -> None:
        header_ns = messages.read_stamp_ns(message)
        self._stamps[topic].header_ns.append(header_ns)
        self._stamps[topic].log_ns.append(log_ns)
        if topic == self.camera.topic:
            now_ns = header_ns if self.clock == "header" else log_ns
            if now_ns is None:
                raise ValueError(f"topic {topic}: a message has no stamp; use recording.mcap.clock=log")
            self.camera.add(message, schema_name, now_ns)
        for (each, path), values in self._values.items():
            if each == topic:
                try:
                    values.append(messages.read_number(message, path))
                except ValueError as error:
                    raise ValueError(f"topic {topic}, message {len(values)}: {error}") from error

    def frame_times(self) -> tuple[Int64[np.ndarray, " T"], Float64[np.ndarray, " T"]]:
        """Numbers of the camera messages whose image is kept, and their times [s]."""
        frame_ns, fresh = self._times[self.camera.topic]
        numbers = np.flatnonzero(fresh)
        kept = np.array([int(number) in self.camera.frames for number in numbers], bool)
        if not kept.any():
            cut = f"skip_s = {self.camera.settings.skip_s} and end_s = {self.camera.settings.end_s}"
            count = len(self._stamps[self.camera.topic].log_ns)
            counts = f"topic {self.camera.topic} has {count} messages, with {cut}"
            raise ValueError(f"{self.path}: no frame to keep; {counts}. Check the cut")
        return numbers[kept], (frame_ns[kept] - self.camera.start_ns) / 1e9

    def samples(self, source: McapInputConfig) -> InputLog:
        """Samples of one input, in seconds from the camera's first message."""
        times, fresh = self._times[source.topic]
        values = np.array(self._values[source.topic, source.field][: len(fresh)])[fresh]
        finite = np.isfinite(values)
        if not finite.all():
            values_lost = f"{(~finite).sum()} of {len(values)} values of {source.field}"
            self._warn(f"topic {source.topic}: {values_lost} are not finite and are taken as missing")
        return InputLog(source.name, (times - self.camera.start_ns)[finite] / 1e9, values[finite])

    def _choose_times(
        self, stamps: messages.Timestamps
    ) -> tuple[Int64[np.ndarray, " K"], Bool[np.ndarray, " N"]]:
        """Times of a topic [ns] and the messages they belong to, up to the first one after the cut."""
        if self.camera.settings.end_s is not None:
            # Messages after the cut are not checked: they may be the reason for the cut.
            end_ns = self.camera.start_ns + round(1e9 * self.camera.settings.end_s)
            times = enumerate(stamps.of_clock(self.clock), 1)
            late = (count for count, time in times if time is not None and time >= end_ns)
            count = next(late, len(stamps.log_ns))
            stamps = messages.Timestamps(stamps.topic, stamps.header_ns[:count], stamps.log_ns[:count])
        return messages.choose_timestamps(stamps, clock=self.clock, source=str(self.path))

    def _warn(self, text: str) -> None:
        warnings.warn(f"{self.path}: {text}", stacklevel=4)


@dataclass
class TopicSummary:
    """Summary of one topic.

    Of a topic with more than 32 numbers, such as a point cloud, only the first message is decoded.
    """

    name: str
    schema: str
    encoding: str
    log_ns: list[int] = field(default_factory=list)  # time of writing of each message [ns]
    header_ns: list[int | None] = field(default_factory=list)  # stamp of each message, None if missing [ns]
    numbers: tuple[str, ...] = ()  # paths of the numbers in the first message, at most 32
    moving: set[str] = field(default_factory=set)  # those of them that change
    problem: str = ""  # why no message was decoded

    @property
    def picture(self) -> str | None:
        """The kind of its images, or None."""
        return image_kind(self.schema)

    @property
    def rate_hz(self) -> float | None:
        """Mean rate of its messages, None for fewer than two or no time between them."""
        span_ns = max(self.log_ns) - min(self.log_ns)
        return 1e9 * (len(self.log_ns) - 1) / span_ns if span_ns else None

    @property
    def longest_gap_s(self) -> float:
        """The longest time between two messages in file order; 0 for a single message."""
        return max((b - a for a, b in pairwise(self.log_ns)), default=0) / 1e9

    @property
    def backwards(self) -> dict[str, int]:
        """Number of backward steps of each clock."""
        header = [ns for ns in self.header_ns if ns is not None]
        clocks = {"log": self.log_ns, "header": header}
        return {name: sum(b < a for a, b in pairwise(times)) for name, times in clocks.items()}

    @property
    def stamped(self) -> bool:
        """Whether every decoded message has a stamp, and not all the same."""
        return None not in self.header_ns and (len(self.header_ns) < 2 or len(set(self.header_ns)) > 1)


@dataclass(frozen=True)
class McapSurvey:
    """Topics of a file, by name, and its damage."""

    path: Path
    topics: tuple[TopicSummary, ...]
    losses: tuple[str, ...]


def survey_mcap(path: StrPath) -> McapSurvey:
    """Summarise every topic of the file at ``path``, damaged or not, in one pass."""
    decoders, losses = messages.Decoders(), list[str]()
    topics: dict[str, TopicSummary] = {}
    first: dict[tuple[str, str], float] = {}
    for schema, channel, message in read_whole_messages(path, losses):
        name = schema.name if schema else ""
        topic = topics.setdefault(channel.topic, TopicSummary(channel.topic, name, channel.message_encoding))
        topic.log_ns.append(message.log_time)
        if not topic.problem and len(topic.numbers) < messages.MOST_LISTED:
            try:
                decoded = decoders.decode(schema, channel, message)
            except ValueError as error:
                topic.problem = str(error)
            else:
                _look(topic, decoded, first)
    return McapSurvey(Path(path), tuple(topics[name] for name in sorted(topics)), tuple(losses))


def _look(topic: TopicSummary, message: Any, first: dict[tuple[str, str], float]) -> None:
    topic.header_ns.append(messages.read_stamp_ns(message))
    if topic.picture is not None:
        return
    if not topic.numbers:
        topic.numbers = tuple(islice(messages.list_number_paths(message), messages.MOST_LISTED))
    for path in topic.numbers:
        if path in topic.moving:
            continue
        try:
            value = messages.read_number(message, path)
        except ValueError:
            continue  # an array may be shorter in one message than in another
        if first.setdefault((topic.name, path), value) != value:
            topic.moving.add(path)
