"""The parts of a recording that are worth learning from: clips cut out of it by their times."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lagsplat.io.recording import LEAST_FRAMES, Recording


def cut_spans(recording: Recording, spans_s: Sequence[Sequence[float]]) -> Recording:
    """The frames from ``start`` up to ``stop`` (exclusive) of every span [s since the first frame].

    Each span is a clip of its own, or several where it crosses the border of clips; times stay as they are.
    What lies between spans is left out.

    Raises:
        ValueError: spans overlap or are not in order, or one holds fewer than three frames.
    """
    since = recording.time_s - recording.time_s[0]
    pieces: list[tuple[int, int]] = []
    ended = -np.inf
    for start, stop in spans_s:
        if not ended <= start < stop:
            raise ValueError(
                f"recording.spans_s: [{start}, {stop}] begins before {ended} or ends before it begins; give "
                "spans in order, without overlap"
            )
        ended = stop
        inside = (since >= start) & (since < stop)
        if inside.sum() < LEAST_FRAMES:
            raise ValueError(
                f"recording.spans_s: [{start}, {stop}] holds {inside.sum()} frames of a recording of "
                f"{since[-1]:.3f} s; a clip needs {LEAST_FRAMES}"
            )
        for a, b in recording.segments:
            within = a + np.flatnonzero(inside[a:b])
            pieces += [(int(within[0]), int(within[-1]) + 1)] if len(within) else []
    cut = recording.pieces(pieces)
    return replace(cut, meta={**recording.meta, "spans_s": [list(map(float, span)) for span in spans_s]})
