"""Read a recording from its settings, or a trajectory from a table, a dataset, a robot's log or a session."""

import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from lagsplat.io.config import RecordingConfig, require_joint_unit
from lagsplat.io.files.download import fetch_member
from lagsplat.io.krauss import read_krauss_npz
from lagsplat.io.lerobot.dataset import is_lerobot
from lagsplat.io.lerobot.recording import read_lerobot
from lagsplat.io.lerobot.trajectory import read_lerobot_trajectory
from lagsplat.io.recording.recording import Recording
from lagsplat.io.recording.segments import cut_at_gaps, cut_spans
from lagsplat.io.robot_log.recording import read_log
from lagsplat.io.robot_log.storage import is_log
from lagsplat.io.robot_log.trajectory import read_log_trajectory
from lagsplat.io.robot_log.write import is_session, read_session_motion
from lagsplat.io.trajectory.trajectory import Trajectory, read_trajectory_file
from lagsplat.io.video.read import read_video
from lagsplat.video_quality.frames import FrameSettings


def read_recording(config: RecordingConfig) -> Recording:
    """Read the recording that ``config`` describes; download it if it has no file.

    If ``spans_s`` is given, only these are kept. `cut_at_gaps` cuts clips at gaps in time; a Krauss archive
    has no times and no gaps. Simulated recordings are made by `lagsplat.systems`, not here.

    Raises:
        ValueError, FileNotFoundError, OSError: as the reader of ``config.kind``; or no file is given.
    """
    if config.kind == "krauss":
        recording = _read_krauss(config)
    elif config.kind not in ("video", "mcap", "lerobot"):
        kinds = "krauss, video, mcap, lerobot"
        raise ValueError(f"recording.kind is {config.kind!r}; only {kinds} are read from a file")
    elif config.path is None:
        raise ValueError("recording.path is null; name the film or the log with recording.path=FILE")
    elif config.n_inputs and config.kind == "video":
        raise ValueError(f"recording.n_inputs is {config.n_inputs}, but a film carries no inputs; give 0")
    else:
        settings = FrameSettings(
            crop=config.crop,
            skip_s=config.skip_s,
            end_s=config.end_s,
            size=None if config.height is None or config.width is None else (config.height, config.width),
            rotate=config.rotate,
            grey=config.grey,
            stabilise=config.stabilise,
            dt_s=config.dt_s,
        )
        path = Path(config.path).expanduser()
        if config.kind == "video":
            recording = read_video(path, settings)
        elif config.kind == "lerobot":
            assert config.lerobot is not None, "the configuration requires it of this kind"
            recording = read_lerobot(path, config.lerobot, settings)
        else:
            assert config.mcap is not None, "the configuration requires it of this kind"
            recording = read_log(path, config.mcap, settings)
    if config.spans_s is not None:
        recording = cut_spans(recording, config.spans_s)
    return cut_at_gaps(recording)


def _read_krauss(config: RecordingConfig) -> Recording:
    assert config.dt_s is not None, "the configuration requires it of this kind"
    archive = config.archive
    if config.path is not None:
        path = Path(config.path).expanduser()
    elif archive is not None and config.member is not None:
        path = fetch_member(archive, config.member)
    else:
        raise ValueError("recording.path is null and no archive with a member is given; give recording.path")
    recording = read_krauss_npz(path, dt_s=config.dt_s, expected_inputs=config.n_inputs)
    if archive is None or recording.meta["sha256"] not in archive.member_sha256.values():
        return recording
    return replace(recording, meta={**recording.meta, "licence": archive.licence, "source": archive.url})


def read_trajectory(
    path: str | os.PathLike[str],
    *,
    columns: Mapping[str, str] | None = None,
    joint_unit: str | None = None,
) -> Trajectory:
    """Read a trajectory from a table, a LeRobot dataset, a robot's log or a saved session.

    Tables are CSV, Parquet, NPZ, MATLAB or HDF5 files, logs are MCAP files or ROS 2 bags.
    ``columns`` maps standard names to the file's own, as in `read_trajectory_file`; of a log to the numbers
    in its messages, ``TOPIC.FIELD``, as in `read_log_trajectory`. ``joint_unit``, ``degree``, ``radian`` or
    ``as_written``, is that of the joints in a LeRobot dataset, as in `read_lerobot_trajectory`; other files
    are read as they are.

    Example:
        >>> import lagsplat
        >>> trajectory = lagsplat.read_trajectory("real.csv")
        >>> trajectory.q_names, trajectory.u_names
        (('q0',), ('u0',))
    """
    path = Path(path).expanduser()
    if is_lerobot(path):
        require_joint_unit("joint_unit", joint_unit)
        return read_lerobot_trajectory(path, columns=columns, joint_unit=joint_unit)
    if is_log(path):
        is_saved = path.suffix.lower() == ".mcap" and is_session(path)
        return read_session_motion(path) if is_saved else read_log_trajectory(path, columns=columns)
    return read_trajectory_file(path, columns=columns)
