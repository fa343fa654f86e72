"""The files that the arguments ``sim`` and ``real`` name, their kinds, and the trajectories in them."""

import csv
import re
import warnings
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from lagsplat.io.files.artifact import read_header
from lagsplat.io.lerobot.dataset import is_lerobot
from lagsplat.io.read import read_trajectory
from lagsplat.io.robot_log.storage import is_log
from lagsplat.io.robot_log.survey import has_images
from lagsplat.io.robot_log.write import is_session
from lagsplat.io.trajectory.sysid_series import find_control_file
from lagsplat.io.trajectory.trajectory import Trajectory
from lagsplat.io.video.clips import IMAGE_SUFFIXES, VIDEO_SUFFIXES, natural_order

TABLES = (".csv", ".txt", ".tsv", ".parquet", ".pq", ".mat", ".h5", ".hdf5")  # suffixes of trajectories
VIDEOS = (*VIDEO_SUFFIXES, ".mcap")
VIDEO_KINDS = ("video", "mcap", "krauss", "recording")  # hold frames, and need an encoder
PYTHON_OBJECT = r"([A-Za-z_][\w.]*|.+\.py):[A-Za-z_][\w.]*"  # module:attribute or file.py:attribute


@dataclass(frozen=True)
class DataSource:
    """A file, folder or Python object that ``sim`` or ``real`` names."""

    kind: str  # one of `VIDEO_KINDS`, or `trajectory`, `run`, `model`, `mujoco`, `python`
    path: str  # a path, or `module:attribute`
    inputs: str | None = None  # table of the inputs that belong to a video


def find_sources(argument: str) -> tuple[DataSource, ...]:
    """Find what ``a.csv``, ``[a.csv,b.csv]``, ``runs/*.csv``, a folder or ``module:attribute`` names.

    A folder is a fitted run if it holds ``dynamics.safetensors``, a trajectory if it is a LeRobot dataset, a
    log if a recorder of ROS 2 made it, a video if it holds images, and otherwise stands for all readable
    files in it, in natural order of their names. A table with the stem of a video beside it holds that
    video's inputs and is no trajectory. The kind of an archive, a log or an artefact is read from its
    content: a log with a camera is a video.

    Raises:
        FileNotFoundError: nothing is there, or nothing matches.
        ValueError: a kind of file that is not known; the message lists those that are.
    """
    names = _split_list(argument)
    if not names:
        raise ValueError("an empty list of files; name at least one")
    paths: list[Path] = []
    objects: list[DataSource] = []
    for name in names:
        path = Path(name).expanduser()
        if not path.exists() and re.fullmatch(PYTHON_OBJECT, name):
            objects.append(DataSource("python", name))
        else:
            paths += _expand(path)
    video_stems = {path.with_suffix("") for path in paths if path.suffix.lower() in VIDEOS}
    controls = {find_control_file(path) for path in paths}  # read with the measurements beside them
    kept = []
    for path in dict.fromkeys(paths):
        is_input_log = path.suffix.lower() in TABLES and path.with_suffix("") in video_stems
        if not is_input_log and path not in controls:
            kept.append(_classify(path))
    return (*objects, *kept)


def read_sources(
    sources: Sequence[DataSource],
    *,
    columns: Mapping[str, str] | None = None,
    joint_unit: str | None = None,
) -> tuple[Trajectory, ...]:
    """Read tables, LeRobot datasets, the numbers of logs, and sessions, as `read_trajectory` does.

    Raises:
        ValueError: a source is a model or a video, or a file is unreadable.
    """
    for source in sources:
        if source.kind in VIDEO_KINDS and source.kind != "mcap":
            raise ValueError(
                f"{source.path}: a video needs the encoder of a fitted run to become a trajectory; "
                "give a film or a run as sim, or give trajectories"
            )
        if source.kind not in ("trajectory", "mcap"):
            raise ValueError(f"{source.path}: a {source.kind} is a model and has no trajectory of its own")
    return tuple(_read_source(source, columns, joint_unit) for source in sources)


def _read_source(source: DataSource, columns: Mapping[str, str] | None, joint_unit: str | None) -> Trajectory:
    try:
        return read_trajectory(source.path, columns=columns, joint_unit=joint_unit)
    except ValueError as error:
        if source.kind != "mcap":
            raise
        raise ValueError(f"{error}. Its images are compared where sim= is a film or a fitted run") from error


def prefer_numbers(sources: Sequence[DataSource], columns: Mapping[str, str]) -> tuple[DataSource, ...]:
    """The sources with logs that have a camera taken as trajectories, if ``columns`` names topics."""
    names_topics = any(own.startswith("/") for own in columns.values())
    return tuple(
        DataSource("trajectory", each.path) if names_topics and each.kind == "mcap" else each
        for each in sources
    )


def adopt_names(motions: Sequence[Trajectory], sims: Sequence[Trajectory]) -> tuple[Trajectory, ...]:
    """Give joints that have names of their own the names ``q0, ...`` of the sim's tables, in their order.

    Inputs likewise. Trajectories of other numbers of coordinates or inputs keep their names, and so do all
    where the sim's names are no standard ones; a warning lists the pairs.
    """
    if not sims:
        return tuple(motions)
    q_names, u_names = sims[0].q_names, sims[0].u_names
    standard = [f"q{i}" for i in range(len(q_names))] + [f"u{i}" for i in range(len(u_names))]
    if [*q_names, *u_names] != standard:
        return tuple(motions)
    return tuple(_rename_by_place(motion, q_names, u_names) for motion in motions)


def _rename_by_place(motion: Trajectory, q_names: tuple[str, ...], u_names: tuple[str, ...]) -> Trajectory:
    own, other = (*motion.q_names, *motion.u_names), (*q_names, *u_names)
    if own == other or (motion.d, motion.n_u) != (len(q_names), len(u_names)):
        return motion
    listed = ", ".join(f"{theirs} is {ours}" for theirs, ours in zip(other, own, strict=True))
    warnings.warn(f"{motion.source}: by its place among the sim's columns, {listed}", stacklevel=4)
    return replace(motion, q_names=q_names, u_names=u_names)


def _split_list(argument: str) -> list[str]:
    text = argument.strip()
    if not (text.startswith("[") and text.endswith("]")):
        return [text.strip("'\"")] if text else []
    cells = next(csv.reader([text[1:-1]], skipinitialspace=True, quotechar='"'), [])
    return [cell.strip().strip("'\"") for cell in cells if cell.strip()]


def _expand(path: Path) -> list[Path]:
    """The files that a path, a pattern or a folder stands for, in natural order."""
    if not path.exists():
        root = Path(path.anchor or ".")
        pattern = str(path.relative_to(path.anchor)) if path.anchor else str(path)
        matches = sorted(root.glob(pattern), key=natural_order) if re.search(r"[*?\[]", pattern) else []
        if not matches:
            raise FileNotFoundError(f"{path}: no such file or folder, and no pattern that matches; check it")
        return [file for match in matches for file in ([match] if match.is_file() else _expand(match))]
    if path.is_file() or (path / "dynamics.safetensors").is_file() or is_lerobot(path) or is_log(path):
        return [path]
    inside = sorted((item for item in path.iterdir() if item.is_file()), key=natural_order)
    if any(item.suffix.lower() in IMAGE_SUFFIXES for item in inside):
        return [path]
    known = [item for item in inside if item.suffix.lower() in (*TABLES, *VIDEOS, ".npz") or is_log(item)]
    if not known:
        raise FileNotFoundError(
            f"{path}: a folder without a trajectory, a video or dynamics.safetensors; name the files"
        )
    return known


def _classify(path: Path) -> DataSource:
    """Find the kind of a single file or folder, by its name or, where this is ambiguous, by its content."""
    name, suffix = str(path), path.suffix.lower()
    if (path / "dynamics.safetensors").is_file():  # perhaps with an exported log in the folder
        return DataSource("run", name)
    if is_lerobot(path):
        return DataSource("trajectory", name)
    if is_log(path):
        return _classify_log(path)
    if path.is_dir():
        return DataSource("video", name)
    if suffix in TABLES:
        return DataSource("trajectory", name)
    if suffix in VIDEOS:
        return DataSource("video", name, _find_inputs(path))
    if suffix == ".npz":
        try:
            with zipfile.ZipFile(path) as archive:
                has_images = "images.npy" in archive.namelist()
        except (zipfile.BadZipFile, NotImplementedError) as error:
            raise ValueError(f"{path}: damaged or not an NPZ archive ({error}); write it again") from error
        return DataSource("krauss" if has_images else "trajectory", name)
    if suffix in (".xml", ".urdf"):
        return DataSource("mujoco", name)
    if suffix == ".xacro":
        raise ValueError(f"{path}: holds macros; expand them first: xacro {path.name} > robot.urdf")
    if suffix == ".py":
        raise ValueError(f"{path}: a program; name what in it is the simulator, as {path}:NAME")
    if suffix == ".safetensors":
        kind = read_header(path)["kind"]
        if kind == "dynamics":
            return DataSource("run", str(path.parent))
        return DataSource("recording" if kind == "recording" else "model", name)
    raise ValueError(
        f"{path}: {suffix or 'a file without suffix'} is neither a trajectory ({', '.join(TABLES)}, .npz), a "
        f"video ({', '.join(VIDEOS)}), a ROS 2 bag, a fitted run, a MuJoCo model (.xml, .urdf) nor "
        "module:attribute"
    )


def _find_inputs(path: Path) -> str | None:
    """The table of inputs beside a video."""
    tables = (path.with_suffix(table) for table in TABLES if table != ".txt")  # which mostly are notes
    return next((str(table) for table in tables if table.is_file()), None)


def _classify_log(path: Path) -> DataSource:
    """A log is a video if it has a camera; also if it cannot be read, which says why where it is read."""
    if path.suffix.lower() == ".mcap" and path.is_file() and is_session(path):
        return DataSource("trajectory", str(path))
    try:
        is_film = has_images(path)
    except (OSError, ValueError):
        is_film = True
    return (
        DataSource("mcap", str(path), _find_inputs(path)) if is_film else DataSource("trajectory", str(path))
    )
