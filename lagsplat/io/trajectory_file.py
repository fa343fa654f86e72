"""A motion from whichever file holds one: a table, or a session in which a simulation was pushed."""

import os
from collections.abc import Mapping

from lagsplat.io.motion import Motion, read_motion
from lagsplat.io.session_mcap import session_motion


def read_trajectory(path: str | os.PathLike[str], *, columns: Mapping[str, str] | None = None) -> Motion:
    """The motion in a CSV, Parquet or NPZ file, whose ``columns`` may be named, or in a session's MCAP file.

    Raises:
        FileNotFoundError, ValueError: as `read_motion` and `session_motion`.
    """
    if os.fspath(path).lower().endswith(".mcap"):
        return session_motion(path)
    return read_motion(path, columns=columns)
