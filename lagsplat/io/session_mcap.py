"""A pushed simulation as an MCAP file, and back: its states, inputs and forces, for Foxglove and for a
diagnosis."""

import json
import os
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.exceptions import McapError
from mcap.reader import make_reader

from lagsplat.io.mcap_write import NumberTopic, PictureTopic, write_mcap
from lagsplat.io.motion import Motion

KIND = "session"
NAMES = ("q", "v", "u", "load", "force", "place", "edits", "energy", "clip")
ABOUT = {
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
    """Rows ``dt_s`` apart: the columns of `NAMES`, each (N, k). ``meta`` is plain data."""

    dt_s: float
    columns: Mapping[str, np.ndarray]
    meta: Mapping[str, Any] = field(default_factory=dict)


def save_session(
    path: str | os.PathLike[str], log: SessionLog, *, pictures: Sequence[PictureTopic] = ()
) -> None:
    """Write a session to a new file; `read_session` gives it back to the last bit.

    Raises:
        FileExistsError, ValueError: as `lagsplat.io.mcap_write.write_mcap`.
    """
    time_s = log.dt_s * np.arange(len(log.columns["q"]))
    meta = {"kind": KIND, "dt_s": log.dt_s, **log.meta}
    write_mcap(
        path,
        pictures=pictures,
        numbers=[NumberTopic(TOPIC, time_s, log.columns, ABOUT)],
        metadata={key: json.dumps(value) for key, value in meta.items()},
    )


def is_session(path: str | os.PathLike[str]) -> bool:
    """Whether an MCAP file is a session that was saved here."""
    try:
        return _metadata(Path(path)).get("kind") == KIND
    except ValueError:
        return False


def read_session(path: str | os.PathLike[str]) -> SessionLog:
    """A session that `save_session` wrote.

    Raises:
        FileNotFoundError: nothing is at ``path``.
        ValueError: another kind of file, or a damaged one.
    """
    meta = _metadata(Path(path))
    if meta.get("kind") != KIND or not isinstance(meta.get("dt_s"), float) or not 0 < meta["dt_s"] < np.inf:
        raise ValueError(f"{path}: an MCAP file, but no session that was saved by pushing a simulation")
    try:
        with open(path, "rb") as file:
            rows = [json.loads(message.data) for _, _, message in make_reader(file).iter_messages([TOPIC])]
        columns = {name: np.array([row[name] for row in rows], dtype=np.float64) for name in NAMES}
    except (McapError, ValueError, KeyError, TypeError, struct.error) as error:
        raise ValueError(f"{path}: its states cannot be read ({error}); save the session again") from error
    shapes = {name: column.ndim for name, column in columns.items()}
    if not rows or set(shapes.values()) != {2} or not all(np.isfinite(c).all() for c in columns.values()):
        raise ValueError(f"{path}: {len(rows)} states whose columns do not fit; save the session again")
    return SessionLog(meta["dt_s"], columns, {key: meta[key] for key in meta if key not in ("kind", "dt_s")})


def session_motion(path: str | os.PathLike[str]) -> Motion:
    """A session as a motion, for instance the sim of a diagnosis.

    Pushes are inputs, too: where there were any, ``push0, ...`` stand beside the recording's inputs.

    Raises:
        FileNotFoundError, ValueError: as `read_session`.
    """
    log = read_session(path)
    columns, clip = log.columns, log.columns["clip"][:, 0]
    starts = [0, *(1 + np.flatnonzero(np.diff(clip))).tolist()]
    names = tuple(str(name) for name in log.meta.get("inputs", ()))
    pushed = columns["load"] if columns["load"].any() else columns["load"][:, :0]
    u_names = (*names, *(f"push{i}" for i in range(pushed.shape[1])))
    return Motion(
        time_s=log.dt_s * np.arange(len(clip)),
        q=columns["q"],
        v=columns["v"],
        u=np.concatenate([columns["u"], pushed], axis=1),
        segments=tuple(zip(starts, [*starts[1:], len(clip)], strict=True)),
        u_names=u_names if len(u_names) == columns["u"].shape[1] + pushed.shape[1] else (),
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
    except (McapError, ValueError, OSError, struct.error) as error:
        raise ValueError(f"{path}: not a whole MCAP file ({error})") from error
