"""Interpolate logged numbers to the frames, and cut clips at gaps of either.

Interpolation is linear. Nothing is extrapolated, and no gap is bridged: frames outside a log or inside a gap
are dropped, with a warning that counts them, and the recording is cut into clips at every gap.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float64


@dataclass(frozen=True)
class InputLog:
    """Samples of one number; times [s] strictly increase, on the clock of the frames."""

    name: str
    time_s: Float64[np.ndarray, " N"]
    values: Float64[np.ndarray, " N"]


@dataclass(frozen=True)
class AlignedInputs:
    """Mask of the frames with every number, these numbers, and half-open clips of the frames kept."""

    kept: Bool[np.ndarray, " T"]
    inputs: Float64[np.ndarray, "K n_u"]
    segments: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class AlignmentTerms:
    """What messages call the frames and their source, the clock's setting, and what to do about a gap."""

    frames: str
    source: str
    clock: str
    gap_remedy: str  # with a brace for the longest gap [s]


OF_CAMERA = AlignmentTerms("frames", "camera", "recording.mcap.clock", "raise recording.mcap.max_gap_s={:g}")


def align_log(
    frame_s: Float64[np.ndarray, " T"],
    logs: Sequence[InputLog],
    *,
    max_gap_s: float,
    source: str,
    terms: AlignmentTerms = OF_CAMERA,
) -> AlignedInputs:
    """Interpolate the ``logs`` to frames at the strictly increasing times ``frame_s`` [s].

    Spacings above ``max_gap_s`` [s], in a log or in the frames, are gaps. ``terms`` are for messages.

    Raises:
        ValueError: a log has fewer than two samples, or no frame has every number.
    """
    outside, inside_gap = np.zeros((2, len(frame_s)), bool)
    gap_starts: list[float] = []
    for log in logs:
        if len(log.time_s) < 2:
            raise ValueError(
                f"{source}: input {log.name!r} has {len(log.time_s)} samples; choose one with two or more"
            )
        if log.time_s[-1] < frame_s[0] or log.time_s[0] > frame_s[-1]:
            spans = _ranges(frame_s, [log], terms)
            problem = f"{terms.source} and input {log.name!r} do not overlap; {spans}"
            raise ValueError(f"{source}: {problem}. Check {terms.clock} and the topics")
        outside |= (frame_s < log.time_s[0]) | (frame_s > log.time_s[-1])
        for before, after in pairwise(log.time_s.tolist()):
            if after - before > max_gap_s:
                inside_gap |= (frame_s > before) & (frame_s < after)
                gap_starts.append(before)
    inside_gap &= ~outside
    kept = ~(outside | inside_gap)
    if not kept.any():
        raise ValueError(
            f"{source}: none of the {len(frame_s)} {terms.frames} has a value of every input; "
            f"{_ranges(frame_s, logs, terms)}. Leave an input out, or {terms.gap_remedy.format(max_gap_s)}"
        )
    reasons = []
    if outside.any():
        short = [log for log in logs if log.time_s[0] > frame_s[0] or log.time_s[-1] < frame_s[-1]]
        reasons.append(f"{outside.sum()} lie outside the inputs ({_ranges(frame_s, short, terms)})")
    if inside_gap.any():
        reasons.append(f"{inside_gap.sum()} lie inside gaps of the inputs of more than {max_gap_s:g} s")
    if reasons:
        dropped = f"{(~kept).sum()} of {len(frame_s)} {terms.frames} are dropped: {', '.join(reasons)}"
        warnings.warn(f"{source}: {dropped}", stacklevel=3)
    times = frame_s[kept]
    cuts = {*(np.flatnonzero(np.diff(times) > max_gap_s) + 1), *np.searchsorted(times, gap_starts, "right")}
    borders = [0, *sorted(int(cut) for cut in cuts if 0 < cut < len(times)), len(times)]
    columns = [np.interp(times, log.time_s, log.values) for log in logs]
    inputs = np.stack(columns, axis=1) if columns else np.zeros((len(times), 0))
    return AlignedInputs(kept, inputs, tuple(pairwise(borders)))


def _ranges(frame_s: Float64[np.ndarray, " T"], logs: Sequence[InputLog], terms: AlignmentTerms) -> str:
    spans = [(f"the {terms.source}", frame_s), *((repr(log.name), log.time_s) for log in logs)]
    return ", ".join(f"{name} runs from {times[0]:.3f} s to {times[-1]:.3f} s" for name, times in spans)
