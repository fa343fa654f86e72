"""A trajectory: coordinates over time and the inputs that acted, from any simulator or sensor.

The columns of a file are ``t`` [s], ``q0, q1, ...``, optionally ``v0, v1, ...`` (their rates) and ``u0, u1,
...`` (inputs), and optionally ``segment``, an integer whose change starts a new clip.
"""

import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from lagsplat.io.trajectory.columns import SEGMENT, TIME, Table, count_names, name_columns
from lagsplat.io.trajectory.logged_inputs import LoggedInputs
from lagsplat.io.trajectory.tables import read_table
from lagsplat.io.trajectory.timing import complete_clips, median_spacing_s, require, require_increasing

LONGEST_LOSS = 3.0  # longest gap left by dropped rows inside a clip, in median steps


@dataclass(frozen=True)
class Trajectory:
    """Coordinates ``q`` (T, d) at ``time_s`` (T,), rates ``v`` (T, d) or None, inputs ``u`` (T, n_u).

    ``time_s`` [s] strictly increases and may be uneven; ``v`` is in units of ``q`` per second. ``n_u`` may
    be 0. ``segments`` are half-open ``(start, stop)`` clips that follow one another and cover all samples,
    no motion continues across their borders; empty means one clip. ``resolution`` (d,) are the steps of a
    sensor that counts, in units of ``q`` and 0 where it does not; empty means not known. ``computed`` names
    inputs that were computed along the motion instead of logged, so that no actuator made them. Of means,
    ``input_log`` holds the inputs at the rate of their log. All numbers are finite and become float64.

    Raises:
        ValueError: a field breaks one of these rules; the message names the source, the field and the row.

    Example:
        >>> import lagsplat, numpy
        >>> t = numpy.linspace(0, 1, 5)
        >>> lagsplat.Trajectory(t, q=numpy.sin(t)[:, None], u=numpy.zeros((5, 0))).d
        1
    """

    # No shapes in the annotations: `__post_init__` checks them in every run, with messages for users.
    time_s: np.ndarray
    q: np.ndarray
    u: np.ndarray
    v: np.ndarray | None = None
    segments: tuple[tuple[int, int], ...] = ()
    q_names: tuple[str, ...] = ()
    u_names: tuple[str, ...] = ()
    source: str = "motion"
    resolution: tuple[float, ...] = ()
    computed: tuple[str, ...] = ()
    input_log: LoggedInputs | None = None

    def __post_init__(self) -> None:
        blocks: dict[str, np.ndarray] = {}
        for name in ("time_s", "q", "u", "v"):
            if getattr(self, name) is not None:
                blocks[name] = np.ascontiguousarray(getattr(self, name), dtype=np.float64)
                object.__setattr__(self, name, blocks[name])
        time_s = blocks.pop("time_s")
        n, shape = len(time_s), time_s.shape
        require(time_s.ndim == 1 and n, self.source, f"time_s of shape {shape}; give (T,) times [s]")
        for name, value in blocks.items():
            rows = value.ndim == 2 and len(value) == n and (name == "u" or value.shape[1] > 0)
            rule = f"give ({n}, columns), one row a sample"
            require(rows, self.source, f"{name} of shape {value.shape}; {rule}")
        if self.v is not None and self.v.shape != self.q.shape:
            rule = f"give the rates of q, {self.q.shape}"
            raise ValueError(f"{self.source}: v of shape {self.v.shape}; {rule}")
        for name, value in {**blocks, "time_s": time_s}.items():
            bad = np.argwhere(~np.isfinite(value))
            if bad.size:
                number, sample = value[tuple(bad[0])], bad[0][0]
                raise ValueError(f"{self.source}: {name} is {number} at sample {sample}; give numbers")
        for letter, width in (("q", self.d), ("u", self.n_u)):
            names = tuple(getattr(self, f"{letter}_names")) or tuple(f"{letter}{i}" for i in range(width))
            object.__setattr__(self, f"{letter}_names", names)
            rule = f"give each of {width} columns its own name"
            require(len(set(names)) == width, self.source, f"{letter}_names {names}; {rule}")
        object.__setattr__(self, "segments", complete_clips(self.segments, n, source=self.source))
        require_increasing(time_s, source=self.source)

    @property
    def n(self) -> int:
        """Number of samples, T."""
        return self.time_s.shape[0]

    @property
    def d(self) -> int:
        """Number of coordinates."""
        return self.q.shape[1]

    @property
    def n_u(self) -> int:
        """Number of inputs."""
        return self.u.shape[1]

    @property
    def dt_s(self) -> float:
        """Median spacing of neighbouring samples of one clip [s]."""
        return median_spacing_s(self.time_s, self.segments, source=self.source)

    @property
    def duration_s(self) -> float:
        """Total duration of the clips [s], without the gaps between them."""
        return float(sum(self.time_s[stop - 1] - self.time_s[start] for start, stop in self.segments))

    @property
    def joined(self) -> np.ndarray:
        """Mask (T - 1,) of the steps between neighbouring samples that lie inside one clip."""
        inside = np.ones(self.n - 1, dtype=bool)
        inside[[start - 1 for start, _ in self.segments[1:]]] = False
        return inside

    def clips(self) -> tuple["Trajectory", ...]:
        """Each clip as a trajectory, with its original times."""
        return tuple(self.pieces([clip]) for clip in self.segments)

    def cut(self, at: Sequence[int]) -> "Trajectory":
        """The same samples, with a new clip also starting at each sample of ``at``.

        Raises:
            ValueError: a sample outside the trajectory.
        """
        inside = all(0 <= i < self.n for i in at)
        require(inside, self.source, f"cut at {list(at)}; name samples from 0 to {self.n - 1}")
        starts = sorted({start for start, _ in self.segments} | {int(i) for i in at})
        return replace(self, segments=tuple(pairwise([*starts, self.n])), input_log=None)

    def pieces(self, clips: Sequence[tuple[int, int]]) -> "Trajectory":
        """Only the half-open, ascending sample ranges ``clips``, each a clip of its own.

        Raises:
            ValueError: no range, an empty one, or ranges that overlap.
        """
        require(clips, self.source, "pieces of no range; name at least one (start, stop)")
        kept = np.concatenate([np.arange(start, stop) for start, stop in clips])
        stops = np.cumsum([stop - start for start, stop in clips]).tolist()
        return replace(
            self,
            time_s=self.time_s[kept],
            q=self.q[kept],
            u=self.u[kept],
            v=None if self.v is None else self.v[kept],
            segments=tuple(pairwise([0, *stops])),
            input_log=None,
        )


def read_trajectory_file(
    path: str | os.PathLike[str], *, columns: Mapping[str, str] | None = None
) -> Trajectory:
    """Read the trajectory in a CSV, Parquet, NPZ, MATLAB or HDF5 file.

    ``columns`` maps standard names to the file's own, ``{"t": "time", "q0": "position", "u0": "torque"}``;
    columns with standard names need no entry. A text file may have a byte-order mark, ``#`` comments, spaces
    around its names, tabs or semicolons for commas, and decimal commas beside semicolons.

    Rows that lack a number are dropped with a warning, and the trajectory is cut there if more than
    `LONGEST_LOSS` median steps pass. Clips that each restart their clock are shifted to follow one another,
    a median step apart, with a warning.

    Raises:
        FileNotFoundError: there is no file at ``path``.
        ValueError: another kind of file, a column that is missing or not numeric, times that do not increase
            inside a clip; the message names the row.
    """
    path = Path(path)
    return make_trajectory(name_columns(read_table(path, columns), columns or {}), source=path.name)


def make_trajectory(table: Table, *, source: str) -> Trajectory:
    """The trajectory in a table whose columns have standard names; ``source`` is its name in messages.

    Raises:
        ValueError: as `read_trajectory_file`.
    """
    names = {letter: count_names(table, letter) for letter in "qvu"}
    used = [name for name in (TIME, SEGMENT, *names["q"], *names["v"], *names["u"]) if name in table.columns]
    at = {name: table.numbers(name) for name in used}
    whole = np.ones(len(table.lines), dtype=bool)
    for column in at.values():
        whole &= np.isfinite(column)
    if not whole.any():
        empty = [name for name in used if not np.isfinite(at[name]).any()]
        raise ValueError(f"{table.source}: no row has a number in every column ({empty or used}); fill them")
    kept = np.flatnonzero(whole)
    if len(kept) < len(whole):
        at = {name: column[kept] for name, column in at.items()}
    segment = at.get(SEGMENT, np.zeros(len(kept)))
    broken = np.flatnonzero(segment != np.rint(segment))
    if broken.size:
        place, number = table.place(int(kept[broken[0]])), segment[broken[0]]
        raise ValueError(f"{place}: segment is {number}; number the clips with integers")
    cuts = 1 + np.flatnonzero(np.diff(segment))
    time_s = _one_clock(table, at[TIME], cuts, kept)
    torn = _dropped_rows(table, time_s, cuts, kept, n=len(whole))
    block = {
        letter: np.stack([at[name] for name in names[letter]], axis=1) for letter in "qvu" if names[letter]
    }
    return Trajectory(
        time_s=time_s,
        q=block["q"],
        u=block.get("u", np.zeros((len(kept), 0))),
        v=block.get("v"),
        segments=tuple(pairwise(sorted({0, *cuts.tolist(), *torn.tolist(), len(kept)}))),
        q_names=names["q"],
        u_names=names["u"],
        source=source,
    )


def _one_clock(table: Table, time_s: np.ndarray, cuts: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Strictly increasing times; a clip that restarts its clock is shifted after the previous one."""
    steps = np.diff(time_s)
    wrong = np.setdiff1d(np.flatnonzero(steps <= 0.0), cuts - 1)
    if wrong.size:
        i = int(wrong[0])
        kind = "stands still at" if steps[i] == 0.0 else f"runs back from {time_s[i]:.9g} s to"
        raise ValueError(
            f"{table.place(int(kept[i + 1]))}: t {kind} {time_s[i + 1]:.9g} s ({wrong.size} such rows). "
            "Times must strictly increase inside a clip; drop repeated rows, or mark a new clip in `segment`"
        )
    restarts = cuts[steps[cuts - 1] <= 0.0]
    if not restarts.size:
        return time_s
    moved = time_s.copy()
    inside = np.delete(steps, cuts - 1)
    gap_s = float(np.median(inside)) if inside.size else 1.0
    for cut in restarts:
        moved[cut:] += moved[cut - 1] + gap_s - moved[cut]
    warnings.warn(
        f"{table.source}: {restarts.size} clip(s) begin their own clock; they are laid one after another, "
        f"{gap_s:.6g} s apart, and t is counted from the first",
        stacklevel=3,
    )
    return moved


def _dropped_rows(
    table: Table, time_s: np.ndarray, cuts: np.ndarray, kept: np.ndarray, *, n: int
) -> np.ndarray:
    """Warn of dropped rows, and return the samples at which they split a clip."""
    if len(kept) == n:
        return np.zeros(0, int)
    steps, after = np.diff(time_s), 1 + np.flatnonzero(np.diff(kept) > 1)
    inside = np.delete(steps, cuts - 1)
    usual = float(np.median(inside)) if inside.size else np.inf
    torn = after[steps[after - 1] > LONGEST_LOSS * usual]
    first = int(np.setdiff1d(np.arange(n), kept)[0])
    text = f"{n - len(kept)} of {n} rows lack a number (the first at {table.place(first)}) and are left out"
    new = np.setdiff1d(torn, cuts)
    if new.size:
        text += f", and it is cut at t = {', '.join(f'{t:.6g}' for t in time_s[new[:5]])} s"
    warnings.warn(f"{table.source}: {text}{', ...' if new.size > 5 else ''}", stacklevel=3)
    return torn


def leading_samples(motion: Trajectory, length_s: float) -> Trajectory:
    """The leading clips of a trajectory, ``length_s`` [s] together, the last one cut."""
    pieces: list[tuple[int, int]] = []
    left = length_s
    for start, stop in motion.segments:
        since_s = motion.time_s[start:stop] - motion.time_s[start]
        end = start + int(np.searchsorted(since_s, left, side="right"))
        if end - start > 1 or not pieces:
            pieces.append((start, end))
        left -= float(since_s[end - start - 1])
        if left <= 0.0:
            break
    return motion.pieces(pieces)
