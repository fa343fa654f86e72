"""Read the topics in use of a log in one pass: the images of a camera, stamps, and numbers."""

import difflib
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64

from lagsplat.io.robot_log import messages
from lagsplat.io.robot_log.images import CameraReader
from lagsplat.io.robot_log.storage import read_messages

Times = tuple[Int64[np.ndarray, " K"], Bool[np.ndarray, " N"]]


@dataclass(frozen=True)
class SettingNames:
    """What a user sets to choose another clock, with a brace for its name, and other topics."""

    clock: str
    topics: str


OF_RECORDING = SettingNames(
    "recording.mcap.clock={}", "recording.mcap.camera, or the topic in recording.mcap.inputs"
)
OF_TRAJECTORY = SettingNames("diagnose.columns={{t: {}}}", "diagnose.columns={q0: TOPIC.FIELD, u0: ...}")


class TopicLog:
    """One pass over a log: images of the camera, if there is one, and stamps and values of ``fields``.

    A field is a topic and a path inside its messages. Without a ``clock`` it is that of the headers where
    every topic in use has one that runs forwards, and the log's otherwise.
    """

    def __init__(
        self,
        path: Path,
        fields: Sequence[tuple[str, str]],
        settings: SettingNames,
        *,
        clock: str | None = None,
        camera: CameraReader | None = None,
    ) -> None:
        self.path, self.settings, self.clock, self.camera = path, settings, clock, camera
        used = ([] if camera is None else [camera.topic]) + [topic for topic, _ in fields]
        self._stamps = {topic: messages.Timestamps(topic) for topic in used}
        self._values: dict[tuple[str, str], list[float]] = {field: [] for field in fields}
        self._lacking: dict[tuple[str, str], str] = {}  # why the first message without the number has none

    def read(self) -> None:
        """Read the log once.

        Raises:
            FileNotFoundError, ValueError: as `read_messages`; a topic or a field is not there, a message
                cannot be decoded, or a clock jumps back.
        """
        decoders, losses, last_ns = messages.Decoders(), list[str](), 0
        counts: dict[str, int] = {}
        for schema, channel, message in read_messages(self.path, losses):
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
        self._require_fields(counts)
        self._finish_images()
        if self.clock is None:
            stamps = self._stamps.values()
            self.clock = "header" if all(each.runs_forwards("header") for each in stamps) else "log"
        self._times = {topic: self._choose_times(stamps) for topic, stamps in self._stamps.items()}

    def _take(self, topic: str, message: Any, schema_name: str, log_ns: int) -> None:
        header_ns = messages.read_stamp_ns(message)
        self._stamps[topic].header_ns.append(header_ns)
        self._stamps[topic].log_ns.append(log_ns)
        if self.camera is not None and topic == self.camera.topic:
            now_ns = header_ns if self.clock == "header" else log_ns
            if now_ns is None:
                remedy = self.settings.clock.format("log")
                raise ValueError(f"topic {topic}: a message has no stamp; use {remedy}")
            self.camera.add(message, schema_name, now_ns)
        for (each, path), values in self._values.items():
            if each == topic:
                try:
                    values.append(messages.read_number(message, path))
                except ValueError as error:  # several nodes may publish on one topic, each its own joints
                    self._lacking.setdefault((each, path), f"topic {topic}, message {len(values)}: {error}")
                    values.append(math.nan)

    def _require_fields(self, counts: dict[str, int]) -> None:
        for topic in self._stamps:
            if topic not in counts:
                raise ValueError(f"{self.path}: {missing_topic(topic, counts)}. Set {self.settings.topics}")
        for field, problem in self._lacking.items():
            lacking, count = int(np.isnan(self._values[field]).sum()), len(self._values[field])
            if lacking == count:
                raise ValueError(f"{self.path}: {problem}")
            self._warn(f"{lacking} of {count} messages give no number, as {problem}")

    def _finish_images(self) -> None:
        if self.camera is None:
            return
        try:
            self.camera.finish()
        except ValueError as error:
            raise ValueError(f"{self.path}: topic {self.camera.topic}: {error}") from error
        if bad := self.camera.damaged:
            self._warn(f"{len(bad)} pictures cannot be decoded and are dropped; the first is {bad[0]}")

    def frame_times(self) -> tuple[Int64[np.ndarray, " T"], Float64[np.ndarray, " T"]]:
        """Numbers of the camera messages whose image is kept, and their times [s]."""
        camera = self.camera
        assert camera is not None, "a log that is read without a camera has no frames"
        frame_ns, fresh = self._times[camera.topic]
        numbers = np.flatnonzero(fresh)
        kept = np.array([int(number) in camera.frames for number in numbers], bool)
        if not kept.any():
            cut = f"skip_s = {camera.settings.skip_s} and end_s = {camera.settings.end_s}"
            count = len(self._stamps[camera.topic].log_ns)
            counts = f"topic {camera.topic} has {count} messages, with {cut}"
            raise ValueError(f"{self.path}: no frame to keep; {counts}. Check the cut")
        return numbers[kept], (frame_ns[kept] - camera.start_ns) / 1e9

    def samples(self, topic: str, field: str) -> tuple[Int64[np.ndarray, " K"], Float64[np.ndarray, " K"]]:
        """Times [ns] and values of one field, without those that are not finite."""
        times, fresh = self._times[topic]
        values = np.array(self._values[topic, field][: len(fresh)])[fresh]
        finite = np.isfinite(values)
        if not finite.all() and (topic, field) not in self._lacking:
            values_lost = f"{(~finite).sum()} of {len(values)} values of {field}"
            self._warn(f"topic {topic}: {values_lost} are not finite and are taken as missing")
        return times[finite], values[finite]

    def _choose_times(self, stamps: messages.Timestamps) -> Times:
        """Times of a topic [ns] and the messages they belong to, up to the first one after the cut."""
        assert self.clock is not None, "read() chooses one"
        if self.camera is not None and self.camera.settings.end_s is not None:
            # Messages after the cut are not checked: they may be the reason for the cut.
            end_ns = self.camera.start_ns + round(1e9 * self.camera.settings.end_s)
            times = enumerate(stamps.of_clock(self.clock), 1)
            late = (count for count, time in times if time is not None and time >= end_ns)
            count = next(late, len(stamps.log_ns))
            stamps = messages.Timestamps(stamps.topic, stamps.header_ns[:count], stamps.log_ns[:count])
        setting = self.settings.clock
        return messages.choose_timestamps(stamps, clock=self.clock, source=str(self.path), setting=setting)

    def _warn(self, text: str) -> None:
        warnings.warn(f"{self.path}: {text}", stacklevel=4)


def missing_topic(topic: str, counts: dict[str, int]) -> str:
    """Say that a topic has no message, which is most like it, and which have: ``counts`` by name."""
    near = difflib.get_close_matches(topic, counts, n=1)
    hint = f" (did you mean {near[0]!r}?)" if near else ""
    return f"no message on topic {topic!r}{hint}; topics with messages: {list_counts(counts)}"


def list_counts(counts: dict[str, int]) -> str:
    """Topics with their number of messages, for people."""
    return ", ".join(f"{name} ({count})" for name, count in sorted(counts.items())) or "none"
