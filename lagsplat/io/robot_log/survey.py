"""Survey the topics of a log: their types, rates, gaps, clocks, images and numbers."""

from dataclasses import dataclass, field
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

from lagsplat.io.files.atomic import StrPath
from lagsplat.io.robot_log import messages
from lagsplat.io.robot_log.images import image_kind
from lagsplat.io.robot_log.storage import read_messages


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
class LogSurvey:
    """Topics of a log, by name, and its damage."""

    path: Path
    topics: tuple[TopicSummary, ...]
    losses: tuple[str, ...]


def survey_log(path: StrPath) -> LogSurvey:
    """Summarise every topic of the log at ``path``, damaged or not, in one pass."""
    decoders, losses = messages.Decoders(), list[str]()
    topics: dict[str, TopicSummary] = {}
    first: dict[tuple[str, str], float] = {}
    for schema, channel, message in read_messages(path, losses):
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
    return LogSurvey(Path(path), tuple(topics[name] for name in sorted(topics)), tuple(losses))


def has_images(path: StrPath) -> bool:
    """Whether a topic of the log at ``path`` holds images.

    Raises:
        FileNotFoundError, ValueError: as `read_messages`.
    """
    schemas = (schema for schema, _, _ in read_messages(path, []) if schema is not None)
    return any(image_kind(schema.name) is not None for schema in schemas)


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
