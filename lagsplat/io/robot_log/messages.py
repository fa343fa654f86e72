"""Decode messages of a log, and read their time stamps and numbers.

ROS 2, protobuf and JSON messages have the same interface: a field is a name. A clock that steps backwards is
refused, because nothing shows which side of the step is right. Messages that repeat the previous instant are
dropped, with a warning.
"""

import json
import re
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice
from typing import Any

import numpy as np
from google.protobuf.message import Message as Protobuf
from jaxtyping import Bool, Int64
from mcap.records import Channel, Message, Schema
from mcap.well_known import MessageEncoding
from mcap_protobuf.decoder import DecoderFactory as ProtobufDecoders
from mcap_ros2.decoder import DecoderFactory as Ros2Decoders

from lagsplat.io.robot_log.definitions import complete_definition

STAMPS = ("timestamp", "stamp")
SECONDS, NANOSECONDS = ("sec", "seconds", "secs"), ("nanosec", "nsec", "nanos", "nsecs")
STEP = re.compile(r"\[([^\[\]]+)\]|([^.\[\]]+)")
MOST_LISTED = 32  # entries of an array in a list of fields


class Decoders:
    """Decodes messages to objects with fields; keeps one decoder per encoding and schema."""

    def __init__(self) -> None:
        # By content: the files of a split bag number their channels and schemas each on their own.
        self._known: dict[tuple[str | bytes, ...], Callable[[bytes], Any]] = {}

    def decode(self, schema: Schema | None, channel: Channel, message: Message) -> Any:
        """Decode a message to a ROS 2 namespace, a protobuf message, or JSON data.

        Raises:
            ValueError: no decoder supports the encoding, or the bytes do not match the schema.
        """
        form = () if schema is None else (schema.name, schema.encoding, schema.data)
        key = (channel.message_encoding, *form)
        try:
            if key not in self._known:
                self._known[key] = self._find(schema, channel.message_encoding)
            return self._known[key](message.data)
        except Exception as error:  # every decoder raises its own errors
            where = f"topic {channel.topic}: the message logged at {message.log_time} ns"
            raise ValueError(f"{where} cannot be decoded: {error}") from error

    def _find(self, schema: Schema | None, encoding: str) -> Callable[[bytes], Any]:
        if encoding == "json":
            return json.loads
        if encoding == MessageEncoding.CDR and schema is not None:
            schema = complete_definition(schema)
        for factory in (Ros2Decoders(), ProtobufDecoders()):  # each keeps decoders by the schema's number
            if decoder := factory.decoder_for(encoding, schema):
                return decoder
        described = "no schema" if schema is None else f"a schema in {schema.encoding!r}"
        known = "those read are ROS 2 CDR with 'ros2msg' or 'ros2idl', protobuf, and JSON"
        raise ValueError(f"its encoding is {encoding!r} with {described}; {known}")


def list_fields(message: Any) -> list[str]:
    """Names of the fields of a message; none for a number, text or array."""
    if isinstance(message, dict):
        return list(message)
    if isinstance(message, Protobuf):
        return [field.name for field in message.DESCRIPTOR.fields]
    return list(getattr(type(message), "__slots__", ())) if hasattr(message, "_type") else []


def read_field(message: Any, name: str) -> Any:
    """The field ``name`` of a message, or None if it has none of this name."""
    if name not in list_fields(message):
        return None
    return message[name] if isinstance(message, dict) else getattr(message, name)


def read_stamp_ns(message: Any) -> int | None:
    """The time in the message's header, or in its ``timestamp`` [ns]; None if it has none."""
    for owner in (read_field(message, "header"), message):
        for name in STAMPS:
            if isinstance(owner, Protobuf) and name in list_fields(owner):
                has_presence = owner.DESCRIPTOR.fields_by_name[name].message_type is not None
                if has_presence and not owner.HasField(name):
                    continue  # an unset protobuf field reads as zero
            time_ns = _time_ns(read_field(owner, name))
            if time_ns is not None:
                return time_ns
    return None


def _time_ns(stamp: Any) -> int | None:
    names = list_fields(stamp)
    whole = next((name for name in SECONDS if name in names), None)
    rest = next((name for name in NANOSECONDS if name in names), None)
    if whole is None or rest is None:
        return None
    return int(read_field(stamp, whole)) * 10**9 + int(read_field(stamp, rest))


def read_number(message: Any, path: str) -> float:
    """Read the number at ``path`` in a message.

    A path is names with dots, and indices in brackets; a bracket may also hold the name of an entry, as
    listed in the array ``name`` beside it or in the field ``name`` of the entries themselves.

    Raises:
        ValueError: there is no such field; the message lists the numbers there are.
    """
    value, owner = message, None
    if isinstance(message, dict) and path in message:
        value = message[path]
    else:
        for key, name in STEP.findall(path):
            if name:
                owner, value = value, read_field(value, name)
            else:
                value = _entry(value, key, names=read_field(owner, "name"))
    if isinstance(value, bool | int | float):
        return float(value)
    known = ", ".join(islice(list_number_paths(message), MOST_LISTED))
    raise ValueError(f"field {path!r} is no number; numbers are {known or 'none'}")


def _entry(array: Any, key: str, *, names: Any) -> Any:
    if not _is_array(array) and not isinstance(array, bytes | bytearray):
        return None
    if key.isdigit():
        return array[int(key)] if int(key) < len(array) else None
    labels = list(names) if _is_array(names) else [read_field(entry, "name") for entry in array]
    place = labels.index(key) if key in labels else len(array)
    return array[place] if place < len(array) else None


def _is_array(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str | bytes | bytearray)


def list_number_paths(message: Any, prefix: str = "") -> Iterator[str]:
    """Paths of the numbers in a message, for the first entries of each array; stamps are left out."""
    labels = read_field(message, "name")
    for name in list_fields(message):
        value, path = read_field(message, name), f"{prefix}{name}"
        if _time_ns(value) is None:
            yield from _paths_below(value, path, labels if _is_array(labels) else ())


def _paths_below(value: Any, path: str, labels: Sequence[str]) -> Iterator[str]:
    if isinstance(value, bool | int | float):
        yield path
    elif _is_array(value):
        for i, entry in enumerate(list(value)[:MOST_LISTED]):
            label: Any = read_field(entry, "name")
            if not isinstance(label, str) or not label:
                label = labels[i] if len(labels) == len(value) else i
            yield from _paths_below(entry, f"{path}[{label}]", ())
    else:
        yield from list_number_paths(value, f"{path}.")


@dataclass
class Timestamps:
    """Both clocks of the messages of one topic [ns]; ``header_ns`` is None for a message without a stamp."""

    topic: str
    header_ns: list[int | None] = field(default_factory=list)
    log_ns: list[int] = field(default_factory=list)

    def of_clock(self, clock: str) -> list[int | None]:
        """The times on the clock ``header`` or ``log``."""
        return self.header_ns if clock == "header" else list(self.log_ns)

    def runs_forwards(self, clock: str) -> bool:
        """Whether every message has a time on this clock, later than the one before."""
        times = self.of_clock(clock)
        return None not in times and bool((np.diff(np.array(times, np.int64)) > 0).all())


def choose_timestamps(
    stamps: Timestamps, *, clock: str, source: str, setting: str = "recording.mcap.clock={}"
) -> tuple[Int64[np.ndarray, " K"], Bool[np.ndarray, " N"]]:
    """Strictly increasing times [ns], and the mask of the messages they belong to.

    ``setting`` is what chooses another clock, with a brace for its name.

    Raises:
        ValueError: a message has no stamp, all stamps are equal, or a stamp is before its predecessor; the
            message names both and says whether the other clock runs forwards.
    """
    given, where = stamps.of_clock(clock), f"{source}: topic {stamps.topic}"
    if None in given:
        raise ValueError(f"{where}: message {given.index(None)} has no stamp; use {setting.format('log')}")
    times = np.array(given, np.int64)
    steps = np.diff(times)
    if len(times) > 1 and not steps.any():
        never_set = f"all {len(times)} messages carry the {clock} stamp {times[0]} ns, so it was never set"
        raise ValueError(f"{where}: {never_set}{_other(stamps, clock, setting)}")
    back = np.flatnonzero(steps < 0)
    if back.size:
        i = int(back[0])
        remedy = _other(stamps, clock, setting)
        raise ValueError(
            f"{where}: the {clock} clock jumps back from {times[i] / 1e9:.6f} s (message {i}) to "
            f"{times[i + 1] / 1e9:.6f} s (message {i + 1}), {back.size} such steps{remedy}"
        )
    fresh = np.diff(times, prepend=times[:1] - 1) > 0
    if not fresh.all():
        repeated = f"{(~fresh).sum()} of {len(times)} messages carry the stamp of the one before"
        warnings.warn(f"{where}: {repeated} and are dropped", stacklevel=3)
    return times[fresh], fresh


def _other(stamps: Timestamps, clock: str, setting: str) -> str:
    name = "log" if clock == "header" else "header"
    if stamps.runs_forwards(name):
        return f". The {name} clock runs forwards: use {setting.format(name)}"
    return f". The {name} clock is no better; cut the file there, for instance with `mcap filter`"
