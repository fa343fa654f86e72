"""Cut a recording at gaps in time or to chosen spans, and split off its held-out frames."""

import math
import warnings
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from lagsplat.io.config import SplitConfig
from lagsplat.io.recording.recording import LEAST_FRAMES, Recording

MAX_GAP_FRAMES = 5.0
"""Longest step in median spacings. Shorter gaps, from dropped frames, are integrated with the true
step; over longer ones the constant input and the explicit step are not valid."""
LEAST_PIECE = 8  # frames of the shortest clip kept: a one-step window and the neighbours for its velocities


def cut_at_gaps(recording: Recording) -> Recording:
    """Cut the clips wherever two frames are more than `MAX_GAP_FRAMES` median spacings apart.

    Clips of fewer than `LEAST_PIECE` frames are dropped. A warning gives the cuts and losses. Shorter gaps
    stay inside their clip, because all later steps use the true times. Without a gap nothing changes.

    Raises:
        ValueError: no clip is long enough.
    """
    if all(stop - start < 2 for start, stop in recording.segments):
        return recording
    longest_s = MAX_GAP_FRAMES * recording.dt_s
    pieces: list[tuple[int, int]] = []
    dropped: list[tuple[int, int]] = []
    gaps: list[str] = []
    for start, stop in recording.segments:
        steps = np.diff(recording.time_s[start:stop])
        torn = (start + 1 + np.flatnonzero(steps > longest_s)).tolist()
        gaps += [f"{steps[at - start - 1]:.3f} s after frame {at - 1}" for at in torn]
        for piece in pairwise([start, *torn, stop]):
            short = len(torn) > 0 and piece[1] - piece[0] < LEAST_PIECE
            (dropped if short else pieces).append(piece)
    if not gaps:
        return recording
    text = f"{recording.source}: {len(gaps)} gap(s) of more than {longest_s:.3f} s: {', '.join(gaps)}"
    if not pieces:
        raise ValueError(f"{text}. No piece between them has {LEAST_PIECE} frames; check the times")
    text += f". It is cut there into {len(pieces)} clip(s), and nothing is continued across a cut"
    if dropped:
        lost = sum(stop - start for start, stop in dropped)
        text += f"; {len(dropped)} piece(s) of fewer than {LEAST_PIECE} frames, {lost} in all, are left out"
    warnings.warn(text, stacklevel=2)
    return recording.pieces(pieces)


def cut_spans(recording: Recording, spans_s: Sequence[Sequence[float]]) -> Recording:
    """Keep the frames from ``start`` up to ``stop`` (exclusive) of every span [s since the first frame].

    Each span becomes a clip, or several if it crosses the border of clips; times are unchanged.

    Raises:
        ValueError: spans overlap or are not in order, or one holds fewer than three frames.
    """
    since = recording.time_s - recording.time_s[0]
    pieces: list[tuple[int, int]] = []
    ended = -np.inf
    for start, stop in spans_s:
        if not ended <= start < stop:
            problem = f"[{start}, {stop}] begins before {ended} or ends before it begins"
            raise ValueError(f"recording.spans_s: {problem}; give spans in order, without overlap")
        ended = stop
        inside = (since >= start) & (since < stop)
        if inside.sum() < LEAST_FRAMES:
            counts = f"{inside.sum()} frames of a recording of {since[-1]:.3f} s"
            raise ValueError(
                f"recording.spans_s: [{start}, {stop}] holds {counts}; a clip needs {LEAST_FRAMES}"
            )
        for a, b in recording.segments:
            within = a + np.flatnonzero(inside[a:b])
            pieces += [(int(within[0]), int(within[-1]) + 1)] if len(within) else []
    cut = recording.pieces(pieces)
    return replace(cut, meta={**recording.meta, "spans_s": [list(map(float, span)) for span in spans_s]})


def split_train_held_out(recording: Recording, split: SplitConfig) -> Recording:
    """Set ``n_train`` so that the end of the recording is held out, as ``split`` says.

    Raises:
        ValueError: either part would have fewer than three frames, or there are too few clips.

    Source: paper, Protocol: a contiguous end of the clip, or a whole clip, is held out.
    """
    total, clips = recording.n_frames, recording.segments
    ((name, held_out),) = [(name, value) for name, value in vars(split).items() if value is not None]
    rule = f"{name} = {held_out}"
    if name == "held_out_clips":
        if held_out >= len(clips):
            counts = f"{len(clips)} clip(s), of which {rule} leave none to train on"
            raise ValueError(f"{recording.source}: {counts}; give more clips or hold out a fraction")
        n_train = clips[-held_out][0]
    elif name == "held_out_frames":
        n_train = total - held_out
    else:
        # 0.29 * 100 is 28.999..., whose floor is not the intended 29.
        n_train = math.floor(held_out * total + 1e-9)
    if n_train < LEAST_FRAMES or total - n_train < LEAST_FRAMES:
        raise ValueError(
            f"{recording.source}: frames {total} in number, split into {n_train} and {total - n_train} by "
            f"{rule}; each part needs {LEAST_FRAMES} or more; give a longer recording or another split"
        )
    return replace(recording, n_train=n_train)


def find_crossing_frames(segments: Sequence[tuple[int, int]], n_train: int) -> tuple[int, int, int]:
    """Start, first held-out frame and end of the clip with both training and held-out frames.

    Raises:
        ValueError: the held-out part starts with a clip of its own.
    """
    for start, stop in segments:
        if start < n_train < stop:
            return start, n_train, stop
    raise ValueError(
        "no forecast can cross into the held-out part, as it begins with a new clip; hold out the end of one "
        "(recording.split.held_out_frames)"
    )
