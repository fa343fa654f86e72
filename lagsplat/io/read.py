"""Read a recording from its settings, or a trajectory from a table or a session's MCAP file."""

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from lagsplat.io.config import RecordingConfig
from lagsplat.io.files.download import fetch_member
from lagsplat.io.krauss import read_krauss_npz
from lagsplat.io.mcap.recording import read_mcap
from lagsplat.io.mcap.write import read_session_motion
from lagsplat.io.recording.recording import Recording
from lagsplat.io.recording.segments import cut_at_gaps, cut_spans
from lagsplat.io.trajectory.trajectory import Trajectory, read_trajectory_file
from lagsplat.io.video.read import read_video


def read_recording(config: RecordingConfig) -> Recording:
    """Read the recording that ``config`` describes; download it if it has no file.

    If ``spans_s`` is given, only these are kept. `cut_at_gaps` cuts clips at gaps in time; a Krauss archive
    has no times and no gaps. Simulated recordings are made by `lagsplat.systems`, not here.

    Raises:
        ValueError, FileNotFoundError, OSError: as the reader of ``config.kind``; or no file is given.
    """
    if config.kind not in READERS:
        raise ValueError(f"recording.kind is {config.kind!r}; only {sorted(READERS)} are read from a file")
    recording = READERS[config.kind](config)
    if config.spans_s is not None:
        recording = cut_spans(recording, config.spans_s)
    return cut_at_gaps(recording)


def _krauss(config: RecordingConfig) -> Recording:
    if config.dt_s is None:
        raise ValueError("recording.dt_s is null; give the spacing of frames in seconds")
    if config.path is not None:
        path = Path(config.path).expanduser()
    else:
        if config.archive is None or config.member is None:
            raise ValueError(
                "recording.path is null and no archive with a member is given; set recording.path=FILE"
            )
        path = fetch_member(config.archive, config.member)
    recording = read_krauss_npz(path, dt_s=config.dt_s, expected_inputs=config.n_inputs)
    if config.archive is None or recording.meta["sha256"] not in config.archive.member_sha256.values():
        return recording
    return replace(
        recording,
        meta={**recording.meta, "licence": config.archive.licence, "source": config.archive.url},
    )


def _video(config: RecordingConfig) -> Recording:
    if config.path is None:
        raise ValueError("recording.path is null; name the film with recording.path=FILE")
    if config.n_inputs:
        raise ValueError(
            f"recording.n_inputs is {config.n_inputs}, but a film carries no inputs; set it to 0"
        )
    return read_video(
        config.path,
        crop=config.crop,
        skip_s=config.skip_s,
        size=_size(config),
        end_s=config.end_s,
        dt_s=config.dt_s,
        rotate=config.rotate,
        grey=config.grey,
        stabilise=config.stabilise,
    )


def _mcap(config: RecordingConfig) -> Recording:
    if config.path is None or config.mcap is None:
        raise ValueError(
            "recording.path or recording.mcap is null; name the file with recording.path=FILE.mcap"
        )
    path = Path(config.path).expanduser()
    cut: dict[str, Any] = {"crop": config.crop, "skip_s": config.skip_s, "end_s": config.end_s}
    cut |= {"rotate": config.rotate, "grey": config.grey}
    return read_mcap(path, config.mcap, size=_size(config), **cut)


def _size(config: RecordingConfig) -> tuple[int, int] | None:
    if config.height is None or config.width is None:
        return None
    return config.height, config.width


READERS = {"krauss": _krauss, "video": _video, "mcap": _mcap}


def read_trajectory(path: str | os.PathLike[str], *, columns: Mapping[str, str] | None = None) -> Trajectory:
    """Read a trajectory from CSV, Parquet or NPZ, whose ``columns`` may be named, or from a session's MCAP.

    Example:
        >>> import lagsplat
        >>> trajectory = lagsplat.read_trajectory("real.csv")
        >>> trajectory.q_names, trajectory.u_names
        (('q0',), ('u0',))
    """
    if os.fspath(path).lower().endswith(".mcap"):
        return read_session_motion(path)
    return read_trajectory_file(path, columns=columns)
