"""A recording: frames, their times, the applied inputs, and their origin.

A recording is data, not a file: the readers beside this module make it, and `save_recording` saves it as an
artifact of kind ``recording``. Frames may be a memory map, so a long recording costs nothing until used.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np

from lagsplat.io.files.artifact import load_artifact, save_artifact
from lagsplat.io.files.atomic import StrPath
from lagsplat.io.trajectory.timing import complete_clips, median_spacing_s, require, require_increasing

KIND = "recording"
SCHEMA = 2
ORIGINS = ("simulated", "filmed")
LEAST_FRAMES = 3  # an acceleration needs three


@dataclass(frozen=True)
class Recording:
    """Frames with times [s], inputs with names and units, clips and origin.

    ``frames`` is uint8 (T, H, W, 3), RGB; an array or a memory map. ``time_s`` (T,) strictly increases.
    ``inputs`` is (T, n_u), one row per frame, possibly without columns. ``segments`` are half-open ``(start,
    stop)`` clips that follow one another and cover all frames, no motion continues across their borders;
    empty means one clip. ``states`` (T, n_x) are the true states of a simulation, or None. Numbers except
    frames become float64. The first ``n_train`` frames are for training; None before the split. ``meta`` has
    ``origin`` (``simulated`` or ``filmed``), ``source``, ``sha256``, ``licence``, and further plain data
    from the reader.

    Raises:
        ValueError: a field breaks one of these rules; the message names the source, the field and the value.

    Example:
        >>> import lagsplat, numpy
        >>> frames = numpy.zeros((3, 4, 4, 3), numpy.uint8)
        >>> meta = {"origin": "filmed", "source": "black", "sha256": "0", "licence": "none"}
        >>> times = numpy.arange(3.0)
        >>> lagsplat.Recording(frames, times, numpy.zeros((3, 0)), (), (), meta=meta).n_frames
        3
    """

    # No shapes in the annotations: `__post_init__` checks them in every run, with messages for users.
    frames: np.ndarray
    time_s: np.ndarray
    inputs: np.ndarray
    input_names: tuple[str, ...]
    input_units: tuple[str, ...]
    segments: tuple[tuple[int, int], ...] = ()
    states: np.ndarray | None = None
    meta: Mapping[str, Any] = field(default_factory=dict)
    n_train: int | None = None

    def __post_init__(self) -> None:
        shape, dtype = np.shape(self.frames), getattr(self.frames, "dtype", None)
        images = len(shape) == 4 and shape[-1] == 3 and 0 not in shape and dtype == np.uint8
        problem = f"frames of shape {shape} and dtype {dtype}"
        require(images, self.source, f"{problem}; give uint8 (T, H, W, 3), RGB, T >= 1")
        origin = self.meta.get("origin")
        require(origin in ORIGINS, self.source, f"meta with origin {origin!r}; it is one of {ORIGINS}")
        for name in ("time_s", "inputs", "states"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=np.float64))
        for name in ("input_names", "input_units"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        n, time_s, inputs, states = self.n_frames, self.time_s, self.inputs, self.states
        object.__setattr__(self, "segments", complete_clips(self.segments, n, source=self.source))
        given = time_s.shape == (n,) and np.isfinite(time_s).all()
        require(given, self.source, f"time_s of shape {time_s.shape}; give {n} finite times [s]")
        require_increasing(time_s, source=self.source)
        rows = inputs.ndim == 2 and len(inputs) == n
        require(rows, self.source, f"inputs of shape {inputs.shape}; give ({n}, n_u), one row a frame")
        n_u, names, units = inputs.shape[1], self.input_names, self.input_units
        problem = f"inputs with {n_u} columns, names {names} and units {units}"
        texts = all(isinstance(word, str) for word in (*names, *units))
        one_each = texts and len(names) == len(units) == len(set(names)) == n_u
        require(one_each, self.source, f"{problem}; give every column one name of its own and one unit")
        bad = np.argwhere(~np.isfinite(inputs))
        if bad.size:
            frame, column = bad[0]
            raise ValueError(
                f"{self.source}: input {names[column]!r} is {inputs[frame, column]} at frame {frame} "
                f"({len(bad)} such values); fill the gap or cut the recording there"
            )
        if states is not None:
            finite = states.ndim == 2 and len(states) == n and np.isfinite(states).all()
            problem = f"states of shape {states.shape}"
            require(finite, self.source, f"{problem}; give finite ({n}, n_x), or None")

    @property
    def source(self) -> str:
        """Name of the recording in messages."""
        return f"recording {self.meta.get('source', '(unnamed)')}"

    @property
    def n_frames(self) -> int:
        """Number of frames, T."""
        return self.frames.shape[0]

    @property
    def height(self) -> int:
        """Rows of a frame [pixel]."""
        return self.frames.shape[1]

    @property
    def width(self) -> int:
        """Columns of a frame [pixel]."""
        return self.frames.shape[2]

    @property
    def dt_s(self) -> float:
        """Median spacing of neighbouring frames of one clip [s]."""
        return median_spacing_s(self.time_s, self.segments, source=self.source)

    def part(self, start: int, stop: int) -> "Recording":
        """Frames ``start`` to ``stop`` (exclusive), with times and clips, not split; frames are a view."""
        inside = 0 <= start < stop <= self.n_frames
        rule = f"it must hold a frame and lie within the {self.n_frames} frames"
        require(inside, self.source, f"part [{start}, {stop}); {rule}")
        clips = [
            (max(a, start) - start, min(b, stop) - start) for a, b in self.segments if a < stop and b > start
        ]
        return self._take(slice(start, stop), clips)

    def pieces(self, clips: Sequence[tuple[int, int]]) -> "Recording":
        """Only the half-open frame ranges ``clips``, in order, each a clip of its own; not split."""
        stops = np.cumsum([stop - start for start, stop in clips]).tolist()
        whole = stops[-1] == self.n_frames
        kept = slice(None) if whole else np.concatenate([np.arange(start, stop) for start, stop in clips])
        return self._take(kept, list(pairwise([0, *stops])))

    def _take(self, kept: slice | np.ndarray, clips: Sequence[tuple[int, int]]) -> "Recording":
        return replace(
            self,
            frames=self.frames[kept],
            time_s=self.time_s[kept],
            inputs=self.inputs[kept],
            states=None if self.states is None else self.states[kept],
            segments=tuple(clips),
            n_train=None,
        )

    def split(self) -> tuple["Recording", "Recording"]:
        """The leading ``n_train`` frames, for training, and the rest, held out.

        Raises:
            ValueError: the recording is not split yet (`lagsplat.io.recording.segments`).
        """
        if self.n_train is None:
            raise ValueError(f"{self.source}: n_train None; divide the recording first")
        return self.part(0, self.n_train), self.part(self.n_train, self.n_frames)


def save_recording(path: StrPath, recording: Recording) -> None:
    """Save ``recording`` atomically as an artifact of kind ``recording``."""
    tensors = {"frames": recording.frames, "time_s": recording.time_s, "inputs": recording.inputs}
    if recording.states is not None:
        tensors["states"] = recording.states
    header = {
        "kind": KIND,
        "schema": SCHEMA,
        "input_names": recording.input_names,
        "input_units": recording.input_units,
        "segments": recording.segments,
        "meta": dict(recording.meta),
        "n_train": recording.n_train,
    }
    save_artifact(path, tensors, header)


def load_recording(path: StrPath) -> Recording:
    """Load the recording at ``path``; frames are a read-only memory map.

    Raises:
        FileNotFoundError: there is no file at ``path``.
        ValueError: as `load_artifact`; or what the file holds is no recording.
    """
    tensors, header = load_artifact(path, kind=KIND, schema=SCHEMA, mapped=("frames",))
    missing = {"frames", "time_s", "inputs"} - set(tensors)
    if missing:
        raise ValueError(f"{path}: a recording without {sorted(missing)}; the file was made by other code")
    try:
        return Recording(
            frames=tensors["frames"],
            time_s=tensors["time_s"],
            inputs=tensors["inputs"],
            input_names=tuple(header["input_names"]),
            input_units=tuple(header["input_units"]),
            segments=tuple((start, stop) for start, stop in header["segments"]),
            states=tensors.get("states"),
            meta=header["meta"],
            n_train=header["n_train"],
        )
    except (TypeError, KeyError, OverflowError, AttributeError, IndexError) as error:
        problem = f"{type(error).__name__}: {error}"
        raise ValueError(
            f"{path}: its header or tensors are of other code ({problem}); make it again"
        ) from error
