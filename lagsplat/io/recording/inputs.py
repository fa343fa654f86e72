"""Inputs of a video from a table beside it."""

import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np

from lagsplat.io.files.atomic import StrPath
from lagsplat.io.recording.recording import Recording
from lagsplat.io.trajectory.inputs import read_input_log


def add_inputs(recording: Recording, table: StrPath) -> Recording:
    """Add the inputs of ``table``, interpolated linearly to the frames; their names are ``u0``, ``u1``, ...

    Times of the table [s] are on the clock of the frames. Frames that it does not cover are left out, with a
    warning. The result is not split.

    Raises:
        FileNotFoundError: there is no table.
        ValueError: as `read_input_log`; the recording has inputs already; or the table is of another time.
    """
    name = recording.meta.get("source", Path(table).name)
    if recording.inputs.shape[1]:
        raise ValueError(f"{name}: inputs are in the video and in a table beside it; remove one of them")
    try:
        time_s, inputs = read_input_log(table)
    except ValueError as error:
        taken = f"read as the inputs of {name}, whose stem it has; rename it if it holds something else"
        raise ValueError(f"{error} ({taken})") from error
    slack = 0.5 * recording.dt_s
    covered = (recording.time_s >= time_s[0] - slack) & (recording.time_s <= time_s[-1] + slack)
    if not covered.any():
        raise ValueError(
            f"{name}: its frames are from {recording.time_s[0]:.6g} to {recording.time_s[-1]:.6g} s, "
            f"its inputs from {time_s[0]:.6g} to {time_s[-1]:.6g} s; give both on one clock"
        )
    n_u = inputs.shape[1]
    driven = replace(
        recording,
        inputs=np.stack([np.interp(recording.time_s, time_s, column) for column in inputs.T], axis=1),
        input_names=tuple(f"u{i}" for i in range(n_u)),
        input_units=("unknown",) * n_u,
        n_train=None,
    )
    if covered.all():
        return driven
    warnings.warn(f"{name}: {(~covered).sum()} frames without inputs are left out", stacklevel=2)
    first, last = np.flatnonzero(covered)[[0, -1]]
    clips = [(max(a, int(first)), min(b, int(last) + 1)) for a, b in recording.segments]
    return driven.pieces([(a, b) for a, b in clips if a < b])
