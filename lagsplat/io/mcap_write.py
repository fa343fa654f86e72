"""MCAP files that Foxglove opens: pictures as ``foxglove.CompressedImage``, numbers as JSON with a schema.

Pictures are PNG, so that a recording read back is the one written. A message's stamp and its log time are the
same: ``start_ns`` plus its time in seconds, rounded to the nanosecond. Messages stand in the order of time.
"""

import heapq
import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from jaxtyping import Float64
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer
from mcap_protobuf.schema import register_schema

from lagsplat.io.atomic import replacing

TIME = {
    "type": "object",
    "title": "time",
    "properties": {"sec": {"type": "integer", "minimum": 0}, "nsec": {"type": "integer", "minimum": 0}},
}


@dataclass(frozen=True)
class PictureTopic:
    """Pictures of one topic: RGB, uint8 (H, W, 3), as many as there are times [s]; drawn one at a time."""

    topic: str
    time_s: Float64[np.ndarray, " N"]
    pictures: Iterable[np.ndarray]


@dataclass(frozen=True)
class NumberTopic:
    """Numbers of one topic: each column is (N,) or (N, k), a number or an array in every message.

    ``about`` says what each column is and in which unit; it stands in the schema.
    """

    topic: str
    time_s: Float64[np.ndarray, " N"]
    columns: Mapping[str, np.ndarray]
    about: Mapping[str, str]


def write_mcap(
    path: str | os.PathLike[str],
    *,
    pictures: Sequence[PictureTopic],
    numbers: Sequence[NumberTopic],
    metadata: Mapping[str, str],
    start_ns: int = 0,
) -> None:
    """Write the topics to a new file at ``path``, whole or not at all.

    Raises:
        FileExistsError: something is at ``path``.
        ValueError: a time is negative or out of order, a number is not finite, or a topic has fewer pictures
        than times.
    """
    if Path(path).exists():
        raise FileExistsError(f"{path}: it is there already and is left as it is; delete it or name another")
    with replacing(path) as temporary, temporary.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="", library="lagsplat")
        writer.add_metadata("lagsplat", dict(metadata))
        shown = register_schema(writer, CompressedImage) if pictures else 0
        streams = [_pictures(writer, shown, each, start_ns) for each in pictures]
        streams += [_numbers(writer, each, start_ns) for each in numbers]
        for sequence, (time_ns, channel, data) in enumerate(heapq.merge(*streams, key=lambda item: item[0])):
            writer.add_message(channel, log_time=time_ns, publish_time=time_ns, data=data, sequence=sequence)
        writer.finish()


def _instants(topic: str, time_s: Float64[np.ndarray, " N"], start_ns: int) -> list[int]:
    times = [start_ns + round(1e9 * float(time)) for time in time_s]
    if times and (min(times) < 0 or any(b <= a for a, b in pairwise(times))):
        raise ValueError(
            f"topic {topic}: times from {min(time_s):.6f} s to {max(time_s):.6f} s must be 0 or more "
            "and increase"
        )
    return times


def _pictures(
    writer: Writer, schema: int, source: PictureTopic, start_ns: int
) -> Iterator[tuple[int, int, bytes]]:
    channel = writer.register_channel(source.topic, MessageEncoding.Protobuf, schema)
    frame = source.topic.strip("/").replace("/", "_")
    times = _instants(source.topic, source.time_s, start_ns)
    for time_ns, picture in zip(times, source.pictures, strict=True):
        whole, data = cv2.imencode(".png", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))
        if not whole:
            raise ValueError(f"topic {source.topic}: OpenCV cannot write a picture of shape {picture.shape}")
        message = CompressedImage(frame_id=frame, format="png", data=data.tobytes())
        message.timestamp.FromNanoseconds(time_ns)
        yield time_ns, channel, message.SerializeToString()


def _numbers(writer: Writer, source: NumberTopic, start_ns: int) -> Iterator[tuple[int, int, bytes]]:
    if "timestamp" in source.columns:
        raise ValueError(f"topic {source.topic}: a column may not be called 'timestamp', as the stamp is")
    schema = writer.register_schema(
        name="lagsplat" + source.topic.replace("/", "."),
        encoding=SchemaEncoding.JSONSchema,
        data=json.dumps(_schema(source)).encode(),
    )
    channel = writer.register_channel(source.topic, MessageEncoding.JSON, schema)
    columns = {name: np.asarray(values, np.float64).tolist() for name, values in source.columns.items()}
    for i, time_ns in enumerate(_instants(source.topic, source.time_s, start_ns)):
        stamp = {"sec": time_ns // 10**9, "nsec": time_ns % 10**9}
        message = {"timestamp": stamp} | {name: values[i] for name, values in columns.items()}
        try:
            yield time_ns, channel, json.dumps(message, allow_nan=False).encode()
        except ValueError as error:
            raise ValueError(f"topic {source.topic}: a value at message {i} is not finite") from error


def _schema(source: NumberTopic) -> dict[str, Any]:
    properties: dict[str, Any] = {"timestamp": TIME}
    for name, values in source.columns.items():
        number = {"type": "number"}
        kind = number if np.ndim(values) == 1 else {"type": "array", "items": number}
        properties[name] = kind | {"description": source.about.get(name, "")}
    return {"type": "object", "title": source.topic, "properties": properties}
