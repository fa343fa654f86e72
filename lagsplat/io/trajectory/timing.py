"""Times and clips of samples, as recordings and trajectories have them.

Clips are half-open ``(start, stop)`` ranges of samples; no motion continues across their borders.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

CLIP_GAP_S = 1.0  # between the last sample of a clip and the first of the next, where each has its own clock
Clips = tuple[tuple[int, int], ...]


def require(holds: object, source: str, problem: str) -> None:
    """Raise a ValueError that names ``source`` unless ``holds``."""
    if not holds:
        raise ValueError(f"{source}: {problem}")


def complete_clips(clips: Sequence[Sequence[int]], n: int, *, source: str) -> Clips:
    """The clips as integers, or one clip over all ``n`` samples if none is given.

    Raises:
        ValueError: they are not in order, overlap, or leave samples out.
    """
    whole = tuple((int(start), int(stop)) for start, stop in clips) or ((0, n),)
    stops = [stop for _, stop in whole]
    follow = whole == tuple(pairwise([0, *stops])) and stops[-1] == n and all(a < b for a, b in whole)
    require(follow, source, f"segments {whole}; clips must follow one another from 0 to {n}")
    return whole


def require_increasing(time_s: np.ndarray, *, source: str) -> None:
    """Raise a ValueError unless the times [s] (T,) strictly increase."""
    backwards = 1 + np.flatnonzero(np.diff(time_s) <= 0.0)
    if backwards.size:
        before, after = time_s[backwards[0] - 1], time_s[backwards[0]]
        raise ValueError(
            f"{source}: time_s goes from {before:.9g} s to {after:.9g} s at sample {backwards[0]} "
            f"({backwards.size} such steps); times must strictly increase: repair them, or cut there"
        )


def median_spacing_s(time_s: np.ndarray, clips: Clips, *, source: str) -> float:
    """Median spacing of neighbouring samples of one clip [s].

    Raises:
        ValueError: no clip has two samples.
    """
    spacing = np.concatenate([np.diff(time_s[start:stop]) for start, stop in clips])
    require(spacing.size, source, "no two samples stand in one clip; a spacing in time needs two")
    return float(np.median(spacing))


def lay_out_clocks(clocks: Sequence[np.ndarray]) -> np.ndarray:
    """Times [s] (T,) of clips that each have their own clock, one after another, `CLIP_GAP_S` apart."""
    laid: list[np.ndarray] = []
    for time_s in clocks:
        shift_s = laid[-1][-1] + CLIP_GAP_S - time_s[0] if laid and len(time_s) else 0.0
        laid.append(time_s + shift_s)
    return np.concatenate(laid)
