"""What the arguments ``sim`` and ``real`` name: files of which kind, and the motions in them."""

import csv
import re
import warnings
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lagsplat.io.files.artifact import read_header
from lagsplat.io.mcap.write import is_session
from lagsplat.io.read import read_trajectory
from lagsplat.io.recording.recording import Recording
from lagsplat.io.trajectory.inputs import read_input_log
from lagsplat.io.trajectory.trajectory import Trajectory
from lagsplat.io.video.clips import IMAGE_SUFFIXES, VIDEO_SUFFIXES, natural_order

TABLES = (".csv", ".txt", ".tsv", ".parquet", ".pq")
VIDEO_KINDS = ("video", "mcap", "krauss", "recording")
KINDS = ("trajectory", *VIDEO_KINDS, "run", "model", "mujoco", "python")
PYTHON_OBJECT = r"(?P<module>[A-Za-z_][\w.]*|.+\.py):(?P<attribute>[A-Za-z_][\w.]*)"
LatentEncoder = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class DataSource:
    """One thing named: its kind (one of `KINDS`), its path or ``module:attribute``, and the table of the
    inputs that go with a film, if there is one."""

    kind: str
    path: str
    inputs: str | None = None


def find_sources(argument: str) -> tuple[DataSource, ...]:
    """The things that ``a.csv``, ``[a.csv,b.csv]``, ``runs/*.csv``, a folder or ``module:attribute`` name.

    A folder is a fitted run where it holds ``dynamics.safetensors``, a film where it holds pictures, and else
    all that can be read in it, in the order in which a person counts
    names. A table of the same stem as a film beside it holds
    the film's inputs and is no trajectory. Of the names of archives and artefacts the content decides.

    Raises:
        FileNotFoundError: nothing is there, or nothing matches.
        ValueError: a kind of file that is not known; the message lists those that are.
    """
    words = _words(argument)
    if not words:
        raise ValueError("an empty list of files; name at least one")
    paths: list[Path] = []
    found: list[DataSource] = []
    for word in words:
        path = Path(word).expanduser()
        if not path.exists() and re.fullmatch(PYTHON_OBJECT, word):
            found.append(DataSource("python", word))
        else:
            paths += _expand(path)
    films = {path.with_suffix("") for path in paths if path.suffix.lower() in (*VIDEO_SUFFIXES, ".mcap")}
    kept = [
        path
        for path in dict.fromkeys(paths)
        if not (path.suffix.lower() in TABLES and path.with_suffix("") in films)
    ]
    return (*found, *(_source(path) for path in kept))


def read_sources(
    sources: Sequence[DataSource],
    *,
    columns: Mapping[str, str] | None = None,
    record: Callable[[DataSource], Recording] | None = None,
    encode: LatentEncoder | None = None,
) -> tuple[Trajectory, ...]:
    """The motions of trajectories and films; other kinds are models, and must be taken out before.

    ``record`` opens a film; ``encode`` turns its frames (T, H, W, 3), uint8, into latents (T, d).

    Raises:
        ValueError: a model, a film without ``record`` and ``encode``, or as the reader of its kind.
    """
    motions = []
    for source in sources:
        if source.kind == "trajectory":
            motions.append(read_trajectory(source.path, columns=columns))
        elif source.kind not in VIDEO_KINDS:
            raise ValueError(f"{source.path}: a {source.kind} is a model and has no motion of its own")
        elif record is None or encode is None:
            raise ValueError(
                f"{source.path}: a film needs the encoder of a fitted run to become a motion; give the run "
                "as sim=FOLDER, or give trajectories"
            )
        else:
            recording = record(source)
            log = read_input_log(source.inputs) if source.inputs else None
            motions.append(
                make_video_trajectory(recording, encode(recording.frames), log=log, source=source.path)
            )
    return tuple(motions)


def make_video_trajectory(
    recording: Recording,
    latents: np.ndarray,
    *,
    source: str,
    log: tuple[np.ndarray, np.ndarray] | None = None,
) -> Trajectory:
    """A film as a motion: its latents (T, d) at the times of its frames, with its inputs.

    ``log`` holds times (N,) [s] and inputs (N, n_u) on the film's clock; they are interpolated. Frames that
    it does not cover are left out, with a warning.

    Raises:
        ValueError: latents of another length, inputs in the film and beside it, or a log of another time.
    """
    if latents.ndim != 2 or len(latents) != recording.n_frames:
        raise ValueError(f"{source}: latents of shape {latents.shape} for {recording.n_frames} frames")
    name = Path(source).name
    motion = Trajectory(
        time_s=recording.time_s, q=latents, u=recording.inputs, segments=recording.segments, source=name
    )
    if log is None:
        return motion
    if recording.inputs.shape[1]:
        raise ValueError(f"{name}: inputs stand in the film and in a table beside it; remove one of them")
    time_s, inputs = log
    slack = 0.5 * motion.dt_s
    covered = (motion.time_s >= time_s[0] - slack) & (motion.time_s <= time_s[-1] + slack)
    if not covered.any():
        raise ValueError(
            f"{name}: its frames are from {motion.time_s[0]:.6g} to {motion.time_s[-1]:.6g} s, its inputs "
            f"from {time_s[0]:.6g} to {time_s[-1]:.6g} s; give both on one clock"
        )
    columns = [np.interp(motion.time_s, time_s, column) for column in inputs.T]
    motion = replace(motion, u=np.stack(columns, axis=1), u_names=())
    if covered.all():
        return motion
    warnings.warn(f"{name}: {(~covered).sum()} frames without inputs are left out", stacklevel=2)
    first, last = np.flatnonzero(covered)[[0, -1]]
    clips = [(max(a, int(first)), min(b, int(last) + 1)) for a, b in motion.segments]
    return motion.pieces([(a, b) for a, b in clips if a < b])


def _words(argument: str) -> list[str]:
    text = argument.strip()
    if not (text.startswith("[") and text.endswith("]")):
        return [text.strip("'\"")] if text else []
    cells = next(csv.reader([text[1:-1]], skipinitialspace=True, quotechar='"'), [])
    return [cell.strip().strip("'\"") for cell in cells if cell.strip()]


def _expand(path: Path) -> list[Path]:
    """The files that a path, a pattern or a folder stands for."""
    if not path.exists():
        root = Path(path.anchor or ".")
        pattern = str(path.relative_to(path.anchor)) if path.anchor else str(path)
        matches = sorted(root.glob(pattern), key=natural_order) if re.search(r"[*?\[]", pattern) else []
        if not matches:
            raise FileNotFoundError(f"{path}: no such file or folder, and no pattern that matches; check it")
        return [file for match in matches for file in ([match] if match.is_file() else _expand(match))]
    if path.is_file() or (path / "dynamics.safetensors").is_file():
        return [path]
    inside = sorted((item for item in path.iterdir() if item.is_file()), key=natural_order)
    if any(item.suffix.lower() in IMAGE_SUFFIXES for item in inside):
        return [path]
    known = [item for item in inside if item.suffix.lower() in (*TABLES, *VIDEO_SUFFIXES, ".npz", ".mcap")]
    if not known:
        raise FileNotFoundError(
            f"{path}: a folder without a trajectory, a film or dynamics.safetensors; name the files"
        )
    return known


def _source(path: Path) -> DataSource:
    """The kind of one file or folder, by its name and, where that does not tell, its content."""
    name, kind = str(path), path.suffix.lower()
    if path.is_dir():
        return DataSource("run" if (path / "dynamics.safetensors").is_file() else "video", name)
    if kind in TABLES:
        return DataSource("trajectory", name)
    if kind == ".mcap" and is_session(path):
        return DataSource("trajectory", name)
    if kind in VIDEO_SUFFIXES or kind == ".mcap":
        beside = [path.with_suffix(suffix) for suffix in TABLES if path.with_suffix(suffix).is_file()]
        return DataSource(
            "video" if kind in VIDEO_SUFFIXES else "mcap", name, str(beside[0]) if beside else None
        )
    if kind == ".npz":
        return DataSource("krauss" if "images.npy" in _members(path) else "trajectory", name)
    if kind == ".xml":
        return DataSource("mujoco", name)
    if kind == ".safetensors":
        made = read_header(path)["kind"]
        if made == "dynamics":
            return DataSource("run", str(path.parent))
        return DataSource("recording" if made == "recording" else "model", name)
    raise ValueError(
        f"{path}: {kind or 'a file without suffix'} is neither a trajectory ({', '.join(TABLES)}, .npz), a "
        f"film ({', '.join(VIDEO_SUFFIXES)}, .mcap), a fitted run, a MuJoCo model (.xml) nor module:attribute"
    )


def _members(path: Path) -> list[str]:
    try:
        with zipfile.ZipFile(path) as archive:
            return archive.namelist()
    except zipfile.BadZipFile as error:
        raise ValueError(f"{path}: damaged or not an NPZ archive ({error}); write it again") from error
