"""Write MCAP files that Foxglove opens, and save and read sessions: states, inputs and forces.

Images are ``foxglove.CompressedImage`` as PNG, so a recording read back is the one written; numbers are JSON
with a schema. A message's stamp equals its log time: ``start_ns`` plus its time in seconds, rounded to the
nanosecond. Messages are in time order.
"""

import heapq
import json
import struct
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from jaxtyping import Float64
from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import Writer
from mcap_protobuf.schema import register_schema
from zstandard import ZstdError

from lagsplat.io.files.atomic import StrPath, replace_atomically
from lagsplat.io.trajectory.trajectory import Trajectory

DAMAGE = (
    *(McapError, ValueError, OSError, OverflowError, struct.error, ZstdError),
    *(RuntimeError, MemoryError),  # of LZ4; of a length that no memory holds
)
"""What the reader of MCAP raises on a damaged file."""
KIND = "session"
COLUMNS = {
    "q": "whitened latent state",
    "v": "its velocity [1/s]",
    "u": "inputs, in the recording's units",
    "load": "generalised force held until the next message [energy of the law per whitened unit]",
    "force": "force, right, down and, in space, ahead of the film's camera [energy of the law per px]",
    "place": "where it acts [px of training, in space at the pivot]; the middle where nothing is held",
    "edits": "factors on damping, inertia and stiffness",
    "energy": "kinetic, potential, work of the hand, work of the inputs, dissipated [energy of the law]",
    "clip": "counts the resets, where the state jumps",
}
TOPIC = "/session/state"


@dataclass(frozen=True)
class SessionLog:
    """Rows ``dt_s`` apart: the `COLUMNS`, each (N, k). ``meta`` is plain data."""

    dt_s: float
    columns: Mapping[str, np.ndarray]
    meta: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class ImageTopic:
    """Images of one topic: RGB, uint8 (H, W, 3), one per time [s]; consumed one by one."""

    topic: str
    time_s: Float64[np.ndarray, " N"]
    pictures: Iterable[np.ndarray]


def save_session(path: StrPath, log: SessionLog, *, pictures: Sequence[ImageTopic] = ()) -> None:
    """Write a session to a new file; `read_session` restores it exactly."""
    time_s = log.dt_s * np.arange(len(log.columns["q"]))
    meta = {"kind": KIND, "dt_s": log.dt_s, **log.meta}
    write_mcap(
        path,
        pictures=pictures,
        numbers=[NumberTopic(TOPIC, time_s, log.columns, COLUMNS)],
        metadata={key: json.dumps(value) for key, value in meta.items()},
    )


def is_session(path: StrPath) -> bool:
    """Whether an MCAP file was written by `save_session`."""
    try:
        return _metadata(Path(path)).get("kind") == KIND
    except ValueError:
        return False


def read_session(path: StrPath) -> SessionLog:
    """Read a session that `save_session` wrote.

    Raises:
        FileNotFoundError: there is no file at ``path``.
        ValueError: another kind of file, or a damaged one.
    """
    meta = _metadata(Path(path))
    dt_s = meta.pop("dt_s", None)
    if meta.pop("kind", None) != KIND or not isinstance(dt_s, float) or not 0 < dt_s < np.inf:
        raise ValueError(f"{path}: an MCAP file, but no session that was saved by pushing a simulation")
    try:
        with open(path, "rb") as file:
            rows = [json.loads(message.data) for _, _, message in make_reader(file).iter_messages([TOPIC])]
        columns = {name: np.array([row[name] for row in rows], dtype=np.float64) for name in COLUMNS}
    except (*DAMAGE, KeyError, TypeError) as error:
        raise ValueError(f"{path}: its states cannot be read ({error}); save the session again") from error
    if not rows or not all(c.ndim == 2 and np.isfinite(c).all() for c in columns.values()):
        raise ValueError(f"{path}: {len(rows)} states whose columns do not fit; save the session again")
    return SessionLog(dt_s, columns, meta)


def read_session_motion(path: StrPath) -> Trajectory:
    """Read a session as a trajectory, for instance the sim of a diagnosis.

    Pushes are inputs, too: if there were any, ``push0, ...`` follow the recording's inputs.
    """
    log = read_session(path)
    columns, clip = log.columns, log.columns["clip"][:, 0]
    starts = [0, *(1 + np.flatnonzero(np.diff(clip))).tolist()]
    names = tuple(str(name) for name in log.meta.get("inputs", ()))
    pushed = columns["load"] if columns["load"].any() else columns["load"][:, :0]
    u = np.concatenate([columns["u"], pushed], axis=1)
    u_names = (*names, *(f"push{i}" for i in range(pushed.shape[1])))
    return Trajectory(
        time_s=log.dt_s * np.arange(len(clip)),
        q=columns["q"],
        v=columns["v"],
        u=u,
        segments=tuple(pairwise([*starts, len(clip)])),
        u_names=u_names if len(u_names) == u.shape[1] else (),
        source=Path(path).name,
    )


def _metadata(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file; check the path")
    try:
        with path.open("rb") as file:
            entries = list(make_reader(file).iter_metadata())
        found = next((entry.metadata for entry in entries if entry.name == "lagsplat"), {})
        return {key: json.loads(value) for key, value in found.items()}
    except DAMAGE as error:
        raise ValueError(f"{path}: not a whole MCAP file ({error})") from error


TIME = {
    "type": "object",
    "title": "time",
    "properties": {"sec": {"type": "integer", "minimum": 0}, "nsec": {"type": "integer", "minimum": 0}},
}


@dataclass(frozen=True)
class NumberTopic:
    """Numbers of one topic: each column is (N,) or (N, k), a number or an array in every message.

    ``about`` describes each column with its unit, for the schema.
    """

    topic: str
    time_s: Float64[np.ndarray, " N"]
    columns: Mapping[str, np.ndarray]
    about: Mapping[str, str]


def write_mcap(
    path: StrPath,
    *,
    pictures: Sequence[ImageTopic],
    numbers: Sequence[NumberTopic],
    metadata: Mapping[str, str],
    start_ns: int = 0,
) -> None:
    """Write the topics to a new file at ``path``, atomically; ``start_ns`` is the log time of time zero [ns].

    Raises:
        FileExistsError: ``path`` exists.
        ValueError: a time is negative or out of order, a number is not finite, or images are too few.
    """
    if Path(path).exists():
        raise FileExistsError(f"{path}: it is there already and is left as it is; delete it or name another")
    with replace_atomically(path) as temporary, temporary.open("wb") as file:
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
        given = f"times from {min(time_s):.6f} s to {max(time_s):.6f} s"
        raise ValueError(f"topic {topic}: {given} must be 0 or more and increase")
    return times


def _pictures(
    writer: Writer, schema: int, source: ImageTopic, start_ns: int
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
    properties: dict[str, Any] = {"timestamp": TIME}
    for name, values in source.columns.items():
        number = {"type": "number"}
        kind = number if np.ndim(values) == 1 else {"type": "array", "items": number}
        properties[name] = kind | {"description": source.about.get(name, "")}
    schema = writer.register_schema(
        name="lagsplat" + source.topic.replace("/", "."),
        encoding=SchemaEncoding.JSONSchema,
        data=json.dumps({"type": "object", "title": source.topic, "properties": properties}).encode(),
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
