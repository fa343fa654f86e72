"""What a recording is, in words, before anything is trained on it."""

import numpy as np

from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.free import free_segments
from lagsplat.evaluate.protocol import HeldOut
from lagsplat.io.recording import Recording

GAP = 1.5  # spacings above this many medians are gaps
SHOWN = 5


def describe(recording: Recording, *, config: EvaluateConfig) -> str:
    """Origin, size, clock, inputs, gaps, free segments and split, a line each.

    A gap is a spacing of more than 1.5 medians within a clip. Free segments are those of the whole recording,
    by the same rule as the evaluation's.

    Raises:
        ValueError: the recording is not divided.
    """
    train, held_out = recording.split()
    duration_s = recording.time_s[-1] - recording.time_s[0]
    lines = [
        f"source     {recording.meta.get('source')} ({recording.meta.get('origin')})",
        f"licence    {recording.meta.get('licence')}",
        f"frames     {recording.n_frames}, {recording.width} x {recording.height} px, "
        f"{len(recording.segments)} clip(s)",
        f"duration   {duration_s:.3f} s, {1.0 / recording.dt_s:.4f} frames/s, spacing {recording.dt_s:.6f} s",
        f"colours    {_colours(recording)}",
        *(_input(recording, column) for column in range(recording.inputs.shape[1])),
        *([] if recording.inputs.shape[1] else ["inputs     none"]),
        f"gaps       {_gaps(recording)}",
        f"free       {_free(recording, config)}",
        f"split      {train.n_frames} frames to train on, {held_out.n_frames} held out",
    ]
    return "\n".join(lines)


def _colours(recording: Recording) -> str:
    frames = np.asarray(recording.frames[:: max(1, recording.n_frames // 200)])
    moving = frames.astype(np.float32).std(axis=0).max() / 255.0
    return f"{frames.min()} to {frames.max()} of 255; the busiest pixel varies by {moving:.3f} (rms, of 1)"


def _input(recording: Recording, column: int) -> str:
    values = recording.inputs[:, column]
    name, unit = recording.input_names[column], recording.input_units[column]
    return f"input {name:<4} {values.min():.4g} to {values.max():.4g} {unit}, mean {values.mean():.4g}"


def _gaps(recording: Recording) -> str:
    found = []
    for start, stop in recording.segments:
        steps = np.diff(recording.time_s[start:stop])
        found += [
            f"{step:.3f} s after frame {start + i}"
            for i, step in enumerate(steps)
            if step > GAP * recording.dt_s
        ]
    more = f" and {len(found) - SHOWN} more" if len(found) > SHOWN else ""
    return ", ".join(found[:SHOWN]) + more if found else "none"


def _free(recording: Recording, config: EvaluateConfig) -> str:
    still = np.zeros((recording.n_frames, 1))
    held = HeldOut(
        encoded=still,
        latents=still,
        forcing=recording.inputs,
        inputs=recording.inputs,
        segments=recording.segments,
        metric=np.eye(1),
        dt_s=recording.dt_s,
        skip=0,
    )
    found = [
        f"frames {a} to {b} ({(b - a) * recording.dt_s:.1f} s)"
        for a, b in free_segments(held, config)[:SHOWN]
    ]
    return ", ".join(found) if found else f"no stretch of {config.free_min_s:g} s without a change of input"
