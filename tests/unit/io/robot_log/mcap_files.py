"""One mechanism's log, written by this package, by rosbags (ROS 2 CDR) and by Foxglove's own writer."""

import base64
import json
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import foxglove
import numpy as np
from foxglove.channels import CompressedImageChannel, JointStatesChannel
from foxglove.messages import CompressedImage, JointState, JointStates, Timestamp
from mcap.writer import Writer as RecordWriter
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from lagsplat.io.config import McapConfig, McapInputConfig
from lagsplat.io.robot_log.write import ImageTopic, NumberTopic, write_mcap

START_NS = 1_700_000_000_000_000_000
NAMES = ("shoulder", "elbow")


@dataclass
class Take:
    """Pictures (T, H, W, 3) RGB at ``frame_ns``, angles (N, 2) at ``joint_ns`` [ns from the start]."""

    frames: np.ndarray
    frame_ns: np.ndarray
    angles: np.ndarray
    joint_ns: np.ndarray


def take(frames: int = 12) -> Take:
    """Pictures at 20 Hz with jitter, angles at 100 Hz that begin before and end after them."""
    rng = np.random.default_rng(0)
    frame_ns = 50_000_000 * np.arange(frames) + rng.integers(0, 9_000_000, frames)
    joint_ns = 10_000_000 * np.arange(-2, 5 * frames + 4) + 3
    angles = np.stack([np.sin(3e-9 * joint_ns), 1e-9 * joint_ns], axis=1)
    return Take(rng.integers(0, 256, (frames, 6, 8, 3), np.uint8), frame_ns, angles, joint_ns)


def topics(camera: str = "/camera", **changes: Any) -> McapConfig:
    fields = changes.pop("fields", tuple(f"position[{name}]" for name in NAMES))
    inputs = [
        McapInputConfig("/joints", field, name, "rad") for field, name in zip(fields, NAMES, strict=True)
    ]
    return McapConfig(**{"camera": camera, "inputs": inputs, "clock": "header", "max_gap_s": 0.5, **changes})


def png(picture: np.ndarray) -> bytes:
    return cv2.imencode(".png", picture[..., ::-1])[1].tobytes()


def by_this_package(path: Path, film: Take) -> McapConfig:
    joints = {name: film.angles[:, i] for i, name in enumerate(NAMES)}
    write_mcap(
        path,
        pictures=[ImageTopic("/camera", film.frame_ns / 1e9, list(film.frames))],
        numbers=[NumberTopic("/joints", film.joint_ns / 1e9, joints, {})],
        metadata={},
        start_ns=START_NS,
    )
    return topics(fields=NAMES)


def by_rosbags(
    path: Path, film: Take, *, raw: bool = False, header_ns: Sequence[int] | None = None
) -> McapConfig:
    """``header_ns`` replaces the stamps of the pictures; their log times stay."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    stamps = film.frame_ns + START_NS if header_ns is None else header_ns

    def header(ns: int) -> Any:
        time = types["builtin_interfaces/msg/Time"](sec=int(ns) // 10**9, nanosec=int(ns) % 10**9)
        return types["std_msgs/msg/Header"](stamp=time, frame_id="camera")

    kind = "sensor_msgs/msg/Image" if raw else "sensor_msgs/msg/CompressedImage"
    rows = []
    for stamp, ns, picture in zip(stamps, film.frame_ns, film.frames, strict=True):
        height, width = picture.shape[:2]
        fields: dict[str, Any] = {"format": "png", "data": np.frombuffer(png(picture), np.uint8)}
        if raw:
            padded = np.pad(picture.reshape(height, -1), ((0, 0), (0, 5)))
            fields = {"height": height, "width": width, "encoding": "rgb8", "is_bigendian": 0}
            fields |= {"step": 3 * width + 5, "data": padded.reshape(-1)}
        rows.append((int(ns), kind, types[kind](header=header(stamp), **fields)))
    joint = "sensor_msgs/msg/JointState"
    none = np.zeros(0)
    for ns, angles in zip(film.joint_ns, film.angles, strict=True):
        # A driver may list the joints in any order.
        state = types[joint](header(ns + START_NS), list(NAMES[::-1]), angles[::-1].copy(), none, none)
        rows.append((int(ns), joint, state))
    folder = path.with_suffix(".bag")
    with Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        places = {
            kind: writer.add_connection("/camera", kind, typestore=store),
            joint: writer.add_connection("/joints", joint, typestore=store),
        }
        for ns, name, message in sorted(rows, key=lambda row: row[0]):
            writer.write(places[name], ns + START_NS, store.serialize_cdr(message, name))
    shutil.move(next(folder.glob("*.mcap")), path)
    return topics()


def by_foxglove(path: Path, film: Take) -> McapConfig:
    context = foxglove.Context()
    with foxglove.open_mcap(path, context=context):
        camera = CompressedImageChannel("/camera", context=context)
        joints = JointStatesChannel("/joints", context=context)
        rows: list[tuple[int, Any, Any]] = []
        for ns, picture in zip(film.frame_ns + START_NS, film.frames, strict=True):
            image = CompressedImage(timestamp=stamp(ns), frame_id="c", data=png(picture), format="png")
            rows.append((int(ns), camera, image))
        for ns, angles in zip(film.joint_ns + START_NS, film.angles, strict=True):
            states = [JointState(name=name, position=x) for name, x in zip(NAMES, angles, strict=True)]
            rows.append((int(ns), joints, JointStates(timestamp=stamp(ns), joints=states)))
        for ns, channel, message in sorted(rows, key=lambda row: row[0]):
            channel.log(message, log_time=ns + 7)
    return topics(fields=tuple(f"joints[{name}].position" for name in NAMES))


def stamp(ns: int) -> Timestamp:
    return Timestamp(sec=int(ns) // 10**9, nsec=int(ns) % 10**9)


WRITERS = {"lagsplat": by_this_package, "rosbags": by_rosbags, "foxglove": by_foxglove}


def by_json(
    path: Path, rows: Sequence[tuple[str, int, dict[str, Any]]], *, chunk_size: int = 1 << 20
) -> None:
    """(topic, log time [ns], message) as JSON, in this order; topics named /camera are CompressedImage."""
    with path.open("wb") as file:
        writer = RecordWriter(file, chunk_size=chunk_size)
        writer.start()
        places: dict[str, int] = {}
        for topic, ns, message in rows:
            if topic not in places:
                name = "foxglove.CompressedImage" if topic == "/camera" else "some.Numbers"
                schema = writer.register_schema(name, "jsonschema", b"{}")
                places[topic] = writer.register_channel(topic, "json", schema)
            writer.add_message(places[topic], ns, json.dumps(message).encode(), ns)
        writer.finish()


def json_picture(picture: np.ndarray, ns: int | None) -> dict[str, Any]:
    data = base64.b64encode(png(picture)).decode()
    stamped = {} if ns is None else {"timestamp": {"sec": ns // 10**9, "nsec": ns % 10**9}}
    return {**stamped, "format": "png", "data": data}


def json_take(
    film: Take,
    *,
    header_ns: Sequence[int | None] | None = None,
    log_ns: Sequence[int] | None = None,
    value: float = 1.0,
) -> list[tuple[str, int, dict[str, Any]]]:
    """Pictures, then one number /joints x at the samples' times; stamps and log times may be replaced."""
    frame_ns = [int(ns) + START_NS for ns in film.frame_ns]
    headers = frame_ns if header_ns is None else header_ns
    logs = frame_ns if log_ns is None else log_ns
    rows = [
        ("/camera", int(logged), json_picture(picture, stamped))
        for picture, stamped, logged in zip(film.frames, headers, logs, strict=True)
    ]
    for ns in film.joint_ns + START_NS:
        time = {"sec": int(ns) // 10**9, "nsec": int(ns) % 10**9}
        rows.append(("/joints", int(ns), {"timestamp": time, "x": value}))
    return rows
