"""A recording: frames, their times, the applied inputs, and their origin.

A recording is data, not a file: the readers beside this module make it, and `save_recording` saves it as an
artifact of kind ``recording``. Frames may be a memory map, so a long recording costs nothing until used.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from lagsplat.io.files.artifact import load_artifact, save_artifact

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
        if len(shape) != 4 or shape[-1] != 3 or 0 in shape or dtype != np.uint8:
            raise self._error(
                "frames", f"of shape {shape} and dtype {dtype}", "give uint8 (T, H, W, 3), RGB, T >= 1"
            )
        if self.meta.get("origin") not in ORIGINS:
            raise self._error(
                "meta", f"with origin {self.meta.get('origin')!r}", f"origin is one of {ORIGINS}"
            )
        object.__setattr__(self, "time_s", np.asarray(self.time_s, dtype=np.float64))
        object.__setattr__(self, "inputs", np.asarray(self.inputs, dtype=np.float64))
        if self.states is not None:
            object.__setattr__(self, "states", np.asarray(self.states, dtype=np.float64))
        segments = tuple((int(start), int(stop)) for start, stop in self.segments) or ((0, shape[0]),)
        object.__setattr__(self, "segments", segments)
        object.__setattr__(self, "input_names", tuple(self.input_names))
        object.__setattr__(self, "input_units", tuple(self.input_units))
        self._check_time()
        self._check_inputs()
        self._check_states()
        self._check_segments()

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
        steps = [np.diff(self.time_s[start:stop]) for start, stop in self.segments]
        spacing = np.concatenate(steps)
        if spacing.size == 0:
            raise self._error("frames", "with no two in one clip", "a spacing in time needs two")
        return float(np.median(spacing))

    def part(self, start: int, stop: int) -> "Recording":
        """Frames ``start`` to ``stop`` (exclusive), with times and clips, not split; frames are a view."""
        if not 0 <= start < stop <= self.n_frames:
            raise self._error(
                "part",
                f"[{start}, {stop})",
                f"it must hold a frame and lie within the {self.n_frames} frames",
            )
        clips = [
            (max(a, start) - start, min(b, stop) - start) for a, b in self.segments if a < stop and b > start
        ]
        return replace(
            self,
            frames=self.frames[start:stop],
            time_s=self.time_s[start:stop],
            inputs=self.inputs[start:stop],
            states=None if self.states is None else self.states[start:stop],
            segments=tuple(clips),
            n_train=None,
        )

    def pieces(self, clips: Sequence[tuple[int, int]]) -> "Recording":
        """Only the half-open frame ranges ``clips``, in order, each a clip of its own; not split."""
        stops = np.cumsum([stop - start for start, stop in clips]).tolist()
        whole = stops[-1] == self.n_frames
        kept = slice(None) if whole else np.concatenate([np.arange(start, stop) for start, stop in clips])
        return replace(
            self,
            frames=self.frames[kept],
            time_s=self.time_s[kept],
            inputs=self.inputs[kept],
            states=None if self.states is None else self.states[kept],
            segments=tuple(zip([0, *stops[:-1]], stops, strict=True)),
            n_train=None,
        )

    def split(self) -> tuple["Recording", "Recording"]:
        """The leading ``n_train`` frames, for training, and the rest, held out.

        Raises:
            ValueError: the recording is not split yet (`lagsplat.io.recording.segments`).
        """
        if self.n_train is None:
            raise self._error("n_train", "None", "divide the recording first")
        return self.part(0, self.n_train), self.part(self.n_train, self.n_frames)

    def _error(self, name: str, found: str, remedy: str) -> ValueError:
        return ValueError(f"recording {self.meta.get('source', '(unnamed)')}: {name} {found}; {remedy}")

    def _check_time(self) -> None:
        if self.time_s.shape != (self.n_frames,) or not np.isfinite(self.time_s).all():
            raise self._error(
                "time_s",
                f"of shape {self.time_s.shape}",
                f"give {self.n_frames} finite times in seconds, one a frame",
            )
        backwards = np.flatnonzero(np.diff(self.time_s) <= 0.0)
        if backwards.size:
            i = int(backwards[0]) + 1
            raise self._error(
                "time_s",
                f"goes from {self.time_s[i - 1]:.6f} s to {self.time_s[i]:.6f} s at frame {i} "
                f"({backwards.size} such steps)",
                "times must strictly increase; repair the timestamps or cut the recording there",
            )

    def _check_inputs(self) -> None:
        if self.inputs.ndim != 2 or self.inputs.shape[0] != self.n_frames:
            raise self._error(
                "inputs", f"of shape {self.inputs.shape}", f"give ({self.n_frames}, n_u), one row a frame"
            )
        n_u = self.inputs.shape[1]
        if len(self.input_names) != n_u or len(self.input_units) != n_u or len(set(self.input_names)) != n_u:
            raise self._error(
                "inputs",
                f"with {n_u} columns, names {self.input_names} and units {self.input_units}",
                "give every column one name of its own and one unit",
            )
        bad = np.argwhere(~np.isfinite(self.inputs))
        if bad.size:
            raise self._error(
                f"input {self.input_names[bad[0][1]]!r}",
                f"is {self.inputs[tuple(bad[0])]} at frame {bad[0][0]} ({len(bad)} such values)",
                "fill the gap or cut the recording there",
            )

    def _check_states(self) -> None:
        states = self.states
        if states is not None and (
            states.ndim != 2 or len(states) != self.n_frames or not np.isfinite(states).all()
        ):
            raise self._error(
                "states", f"of shape {states.shape}", f"give finite ({self.n_frames}, n_x), or None"
            )

    def _check_segments(self) -> None:
        starts = [start for start, _ in self.segments]
        stops = [stop for _, stop in self.segments]
        follows = starts == [0, *stops[:-1]] and stops[-1] == self.n_frames
        if not follows or any(start >= stop for start, stop in self.segments):
            raise self._error(
                "segments", f"{self.segments}", f"clips must follow one another from 0 to {self.n_frames}"
            )


def save_recording(path: str | os.PathLike[str], recording: Recording) -> None:
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


def load_recording(path: str | os.PathLike[str]) -> Recording:
    """Load the recording at ``path``; frames are a read-only memory map."""
    tensors, header = load_artifact(path, kind=KIND, schema=SCHEMA, mapped=("frames",))
    missing = {"frames", "time_s", "inputs"} - set(tensors)
    if missing:
        raise ValueError(f"{path}: a recording without {sorted(missing)}; the file was made by other code")
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
