"""ROS 2 bags of one arm, written by the library rosbags: joint states, a command, and a camera."""

import re
import shutil
import sqlite3
from collections.abc import Iterable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from tests.unit.io.robot_log.mcap_files import NAMES, START_NS, Take, png

STORAGES = {"sqlite3": StoragePlugin.SQLITE3, "mcap": StoragePlugin.MCAP}
STORE = get_typestore(Stores.ROS2_HUMBLE)
JOINT, COMMAND = "sensor_msgs/msg/JointState", "std_msgs/msg/Float64MultiArray"
CAMERA = "sensor_msgs/msg/CompressedImage"
Row = tuple[str, str, int, Any]  # topic, type, log time [ns], message


@dataclass(frozen=True)
class Arm:
    """Angles, rates, torques (N, 2) at ``ns``, and commands (M, 2) at ``command_ns`` [ns from the start]."""

    ns: np.ndarray
    q: np.ndarray
    v: np.ndarray
    effort: np.ndarray
    command_ns: np.ndarray
    command: np.ndarray


def arm(n: int = 200) -> Arm:
    ns = 10_000_000 * np.arange(n) + np.random.default_rng(1).integers(0, 1_000_000, n)
    t = ns / 1e9
    q = np.stack([np.sin(3.0 * t), 0.5 * np.cos(2.0 * t)], axis=1)
    v = np.stack([3.0 * np.cos(3.0 * t), -np.sin(2.0 * t)], axis=1)
    effort = np.stack([np.cos(5.0 * t), t], axis=1)
    command_ns = 20_000_000 * np.arange(-1, n // 2 + 2)
    command = np.stack([np.sin(4e-9 * command_ns), 1e-9 * command_ns], axis=1)
    return Arm(ns, q, v, effort, command_ns, command)


def header(ns: int) -> Any:
    time = STORE.types["builtin_interfaces/msg/Time"](sec=int(ns) // 10**9, nanosec=int(ns) % 10**9)
    return STORE.types["std_msgs/msg/Header"](stamp=time, frame_id="base")


def joint_rows(of: Arm, *, topic: str = "/joint_states", efforts: bool = True) -> list[Row]:
    none, rows = np.zeros(0), []
    for ns, q, v, tau in zip(of.ns, of.q, of.v, of.effort, strict=True):
        # A driver may list the joints in any order.
        values = (q[::-1].copy(), v[::-1].copy(), tau[::-1].copy() if efforts else none)
        message = STORE.types[JOINT](header(ns + START_NS), list(NAMES[::-1]), *values)
        rows.append((topic, JOINT, int(ns), message))
    return rows


def command_rows(of: Arm) -> list[Row]:
    layout = STORE.types["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
    make = STORE.types[COMMAND]
    return [
        ("/arm/command", COMMAND, int(ns), make(layout, values.copy()))
        for ns, values in zip(of.command_ns, of.command, strict=True)
    ]


def camera_rows(film: Take) -> list[Row]:
    make = STORE.types[CAMERA]
    return [
        ("/camera", CAMERA, int(ns), make(header(ns + START_NS), "png", np.frombuffer(png(frame), np.uint8)))
        for ns, frame in zip(film.frame_ns, film.frames, strict=True)
    ]


def write_bag(
    folder: Path,
    rows: Iterable[Row],
    storage: str,
    *,
    compress: CompressionMode = CompressionMode.NONE,
    store: Typestore = STORE,
) -> Path:
    """Write the rows in the order of their times, counted from `START_NS`."""
    writer = Writer(folder, version=9, storage_plugin=STORAGES[storage])
    writer.set_compression(compress, CompressionFormat.ZSTD)
    with writer:
        places: dict[str, Any] = {}
        for topic, kind, ns, message in sorted(rows, key=lambda row: row[2]):
            if topic not in places:
                places[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(places[topic], ns + START_NS, store.serialize_cdr(message, kind))
    return folder


def split_bag(folder: Path, rows: list[Row], storage: str, *, parts: int = 3) -> Path:
    """A bag of several files, as a recorder splits it: rosbags writes one file, so its bags are joined."""
    rows = sorted(rows, key=lambda row: row[2])
    borders = np.linspace(0, len(rows), parts + 1).astype(int)
    folder.mkdir()
    names = []
    for i in range(parts):
        piece = write_bag(
            folder.parent / f"{folder.name}_part{i}", rows[borders[i] : borders[i + 1]], storage
        )
        (file,) = (each for each in piece.iterdir() if each.name != "metadata.yaml")
        names.append(f"{folder.name}_{i}{file.suffix}")
        shutil.move(file, folder / names[-1])
        metadata = yaml.safe_load((piece / "metadata.yaml").read_text())
        shutil.rmtree(piece)
    metadata["rosbag2_bagfile_information"]["relative_file_paths"] = names
    (folder / "metadata.yaml").write_text(yaml.safe_dump(metadata))
    return folder


def storage_file(folder: Path) -> Path:
    (file,) = (each for each in folder.iterdir() if re.search(r"\.(db3|mcap)(\.zstd)?$", each.name))
    return file


def drop_definitions(folder: Path) -> None:
    """Make an SQLite bag like those before ROS 2 Iron, which hold no definitions of messages."""
    with closing(sqlite3.connect(storage_file(folder))) as database:
        database.execute("DROP TABLE message_definitions")
        database.commit()
