"""Where a clip is torn: gaps in time that no step of the dynamics can bridge."""

import warnings

import numpy as np

from lagsplat.io.recording import Recording

MAX_GAP_FRAMES = 5.0
"""Median spacings that a step may last. A camera that drops some frames leaves such gaps, and the true step
bridges them; over longer ones the held input and the explicit step say nothing any more."""
LEAST_PIECE = 8
"""Frames of a piece worth keeping: it holds a one-step window with room for its velocities."""


def cut_at_gaps(recording: Recording) -> Recording:
    """The recording with its clips cut wherever two frames lie more than `MAX_GAP_FRAMES` medians apart.

    Pieces of fewer than `LEAST_PIECE` frames are left out. A warning says where it was cut and what is left
    out. Shorter gaps stay inside their clip: everything later goes by the true times. Pieces are clips like
    any other from then on. Without such a gap this is the recording itself.

    Raises:
        ValueError: no piece is long enough.
    """
    if all(stop - start < 2 for start, stop in recording.segments):
        return recording
    longest_s = MAX_GAP_FRAMES * recording.dt_s
    pieces: list[tuple[int, int]] = []
    dropped: list[tuple[int, int]] = []
    gaps: list[str] = []
    for start, stop in recording.segments:
        steps = np.diff(recording.time_s[start:stop])
        torn = start + 1 + np.flatnonzero(steps > longest_s)
        gaps += [f"{steps[at - start - 1]:.3f} s after frame {at - 1}" for at in torn]
        for piece in zip((start, *torn.tolist()), (*torn.tolist(), stop), strict=True):
            short = len(torn) > 0 and piece[1] - piece[0] < LEAST_PIECE
            (dropped if short else pieces).append(piece)
    if not gaps:
        return recording
    source = recording.meta.get("source", "(unnamed)")
    lost = sum(stop - start for start, stop in dropped)
    found = f"recording {source}: {len(gaps)} gap(s) of more than {longest_s:.3f} s: {', '.join(gaps)}"
    if not pieces:
        raise ValueError(
            f"{found}. No piece between them has {LEAST_PIECE} frames; check the times, or record it again"
        )
    left_out = f"; {len(dropped)} piece(s) of fewer than {LEAST_PIECE} frames, {lost} in all, are left out"
    warnings.warn(
        f"{found}. It is cut there into {len(pieces)} clip(s), and nothing is continued across a cut"
        f"{left_out if dropped else ''}",
        stacklevel=2,
    )
    return recording.pieces(pieces)
