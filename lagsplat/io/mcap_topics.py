"""What is in an MCAP file: topics, rates, gaps, clocks, pictures and numbers."""

import os
from dataclasses import dataclass, field
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

from mcap.records import Channel, Message, Schema

from lagsplat.io.mcap_message import MOST_LISTED, Decoders, number_at, number_paths, stamp_ns
from lagsplat.io.mcap_picture import message_kind
from lagsplat.io.mcap_stream import whole_messages


@dataclass
class Topic:
    """One topic; times are log times [ns].

    ``numbers`` are paths of the numbers in its first message, at most 32, and ``moving`` those that change.
    ``header_ns`` are the stamps of its messages, None where one has none. A topic with more numbers, such as
    a point cloud, is not looked into any further than its first message. ``problem`` says why no message was
    decoded.
    """

    name: str
    schema: str
    encoding: str
    log_ns: list[int] = field(default_factory=list)
    header_ns: list[int | None] = field(default_factory=list)
    numbers: tuple[str, ...] = ()
    moving: set[str] = field(default_factory=set)
    problem: str = ""

    @property
    def picture(self) -> str | None:
        """The kind of pictures it holds, or None."""
        return message_kind(self.schema)

    @property
    def rate_hz(self) -> float | None:
        """Mean rate of its messages, None for fewer than two or for no time between them."""
        span_ns = max(self.log_ns) - min(self.log_ns)
        return 1e9 * (len(self.log_ns) - 1) / span_ns if span_ns else None

    @property
    def longest_gap_s(self) -> float:
        """The longest time between two messages in the order of the file; 0 for a single message."""
        return max((b - a for a, b in pairwise(self.log_ns)), default=0) / 1e9

    @property
    def backwards(self) -> dict[str, int]:
        """How many steps of each clock go backwards."""
        header = [ns for ns in self.header_ns if ns is not None]
        clocks = {"log": self.log_ns, "header": header}
        return {name: sum(b < a for a, b in pairwise(times)) for name, times in clocks.items()}

    @property
    def stamped(self) -> bool:
        """Whether every message looked at has a stamp, and not all the same one."""
        return None not in self.header_ns and (len(self.header_ns) < 2 or len(set(self.header_ns)) > 1)


@dataclass(frozen=True)
class Survey:
    """Topics of a file, by name, and what of it is damaged."""

    path: Path
    topics: tuple[Topic, ...]
    losses: tuple[str, ...]


def survey(path: str | os.PathLike[str]) -> Survey:
    """Go through the whole file at ``path`` once, whether it is damaged or not.

    Raises:
        FileNotFoundError, ValueError: as `lagsplat.io.mcap_stream.whole_messages`.
    """
    decoders, losses = Decoders(), list[str]()
    topics: dict[str, Topic] = {}
    first: dict[tuple[str, str], float] = {}
    for schema, channel, message in whole_messages(path, losses):
        name = schema.name if schema else ""
        topic = topics.setdefault(channel.topic, Topic(channel.topic, name, channel.message_encoding))
        topic.log_ns.append(message.log_time)
        if topic.problem or len(topic.numbers) >= MOST_LISTED:
            continue
        decoded = _decoded(decoders, topic, schema, channel, message)
        if decoded is not None:
            _look(topic, decoded, first)
    return Survey(Path(path), tuple(topics[name] for name in sorted(topics)), tuple(losses))


def _decoded(
    decoders: Decoders, topic: Topic, schema: Schema | None, channel: Channel, message: Message
) -> Any:
    try:
        return decoders.decode(schema, channel, message)
    except ValueError as error:
        topic.problem = str(error)
        return None


def _look(topic: Topic, message: Any, first: dict[tuple[str, str], float]) -> None:
    topic.header_ns.append(stamp_ns(message))
    if topic.picture is not None:
        return
    if not topic.numbers:
        topic.numbers = tuple(islice(number_paths(message), MOST_LISTED))
    for path in topic.numbers:
        if path in topic.moving:
            continue
        try:
            value = number_at(message, path)
        except ValueError:
            continue  # an array may be shorter in one message than in another
        if first.setdefault((topic.name, path), value) != value:
            topic.moving.add(path)
