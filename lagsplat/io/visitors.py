"""A hand that lets go: something that is in the picture at the start or the end of a film only."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64

LATER = (0.4, 0.8)  # the stretch of the film, as shares of its frames, that shows how it usually looks
LEVELS = 12.0  # a pixel looks unusual if it differs by so many of 255 levels...
SPREADS = 6.0  # ...and by so many standard deviations of the usual stretch
SHARE = 0.002  # of the still pixels must look unusual at once
LARGEST = 0.5  # a visit lasts at most this share of the film


@dataclass(frozen=True)
class Visit:
    """Something is in the picture until ``gone_s`` (None: not at the start) and again from ``back_s`` on.

    ``share`` of the pixels that are otherwise still are covered at most.
    """

    gone_s: float | None
    back_s: float | None
    share: float


def find_visit(grey: Float32[np.ndarray, "T h w"], time_s: Float64[np.ndarray, " T"]) -> Visit | None:
    """What covers still pixels at the start or the end of a film; ``grey`` should be free of flicker.

    Where the system itself moves in the middle of the film nothing can be told, so a hand that touches only
    there goes unseen.
    """
    usual_part = grey[int(LATER[0] * len(grey)) : int(LATER[1] * len(grey))]
    usual, spread = np.median(usual_part, axis=0), usual_part.std(axis=0)
    moving = np.ptp(usual_part, axis=0) > LEVELS + SPREADS * float(np.median(spread))
    # A motion that decays was wider at the start: its surroundings are no witness.
    margin = max(3, max(grey.shape[1:]) // 12)
    still = cv2.dilate(moving.astype(np.uint8), np.ones((2 * margin + 1,) * 2, np.uint8)) == 0
    if still.mean() < 0.05:
        return None
    limit = np.maximum(LEVELS, SPREADS * spread[still])
    covered = np.array([(np.abs(frame[still] - usual[still]) > limit).mean() for frame in grey])
    there = covered > SHARE
    start, end = _leading(there), _leading(there[::-1])
    most = int(LARGEST * len(grey))
    start, end = (0 if length > most else length for length in (start, end))
    if not start and not end:
        return None
    share = max(covered[:start].max(initial=0.0), covered[len(covered) - end :].max(initial=0.0))
    return Visit(
        gone_s=float(time_s[start]) if start else None,
        back_s=float(time_s[len(grey) - end]) if end else None,
        share=float(share),
    )


def _leading(there: Bool[np.ndarray, " T"]) -> int:
    """Frames up to the last of the visit that the first frame belongs to; short gaps are part of it."""
    if not there[:3].any():
        return 0
    absent = np.flatnonzero(np.convolve(there, np.ones(6), mode="full")[5:] == 0)
    stop = int(absent[0]) if len(absent) else len(there)
    return stop
