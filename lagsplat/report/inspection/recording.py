"""What a recording or a video holds, in words, and the configuration that follows from a video."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.free_motion import find_free_segments
from lagsplat.evaluate.protocol import EvaluationSeries
from lagsplat.io.config import RecordingConfig
from lagsplat.io.recording.recording import Recording
from lagsplat.io.video.proposal import IMAGE_MODEL, fit_frame, propose_settings
from lagsplat.report.inspection.words import make_name

GAP_RATIO = 1.5  # a spacing above this many medians is a gap
MAX_LISTED = 5


def describe_recording(recording: Recording, *, config: EvaluateConfig) -> str:
    """Describe origin, size, clock, inputs, gaps, free segments and split, a line each.

    A gap is a spacing of more than 1.5 medians within a clip. Free segments are those of the whole recording,
    by the same rule as the evaluation's.

    Raises:
        ValueError: the recording is not divided.
    """
    train, held_out = recording.split()
    duration_s = recording.time_s[-1] - recording.time_s[0]
    columns = zip(recording.input_names, recording.input_units, recording.inputs.T, strict=True)
    inputs = [
        f"input {name:<4} {values.min():.4g} to {values.max():.4g} {unit}, mean {values.mean():.4g}"
        for name, unit, values in columns
    ]
    lines = [
        f"source     {recording.meta.get('source')} ({recording.meta.get('origin')})",
        f"licence    {recording.meta.get('licence')}",
        f"frames     {recording.n_frames}, {_describe_size(recording)}, {len(recording.segments)} clip(s)",
        f"duration   {duration_s:.3f} s, {1.0 / recording.dt_s:.4f} frames/s, spacing {recording.dt_s:.6f} s",
        f"colours    {_describe_colours(recording)}",
        *(inputs or ["inputs     none"]),
        f"gaps       {_describe_gaps(recording)}",
        f"free       {_describe_free(recording, config)}",
        f"split      {train.n_frames} frames to train on, {held_out.n_frames} held out",
    ]
    return "\n".join(lines)


def _describe_size(recording: Recording) -> str:
    own = f"{recording.width} x {recording.height} px"
    first, *_ = recording.meta.get("clips") or [{}]
    rows, columns = first.get("picture_px", (recording.height, recording.width))
    whole = f"{columns} x {rows} px"
    return own if whole == own else f"{whole}, read as {own}"


def _describe_colours(recording: Recording) -> str:
    frames = np.asarray(recording.frames[:: max(1, recording.n_frames // 200)])
    moving = frames.astype(np.float32).std(axis=0).max() / 255.0
    return f"{frames.min()} to {frames.max()} of 255; the busiest pixel varies by {moving:.3f} (rms, of 1)"


def _describe_gaps(recording: Recording) -> str:
    gaps = []
    for start, stop in recording.segments:
        for frame, step in enumerate(np.diff(recording.time_s[start:stop]), start=start):
            if step > GAP_RATIO * recording.dt_s:
                gaps.append(f"{step:.3f} s after frame {frame}")
    more = f" and {len(gaps) - MAX_LISTED} more" if len(gaps) > MAX_LISTED else ""
    return ", ".join(gaps[:MAX_LISTED]) + more if gaps else "none"


def _describe_free(recording: Recording, config: EvaluateConfig) -> str:
    still, inputs = np.zeros((recording.n_frames, 1)), recording.inputs
    clips, dt_s = recording.segments, recording.dt_s
    whole = EvaluationSeries(still, still, inputs, inputs, clips, metric=np.eye(1), dt_s=dt_s, skip=0)
    segments = [
        f"frames {start} to {stop} ({(stop - start) * recording.dt_s:.1f} s)"
        for start, stop in find_free_segments(whole, config)[:MAX_LISTED]
    ]
    return ", ".join(segments) or f"no stretch of {config.free_min_s:g} s without a change of input"


def describe_video(recording: Recording) -> str:
    """Describe the quality of a video, ``recording.meta["footage"]``, with a block of lines for each clip."""
    lines = []
    for clip, quality in zip(recording.meta["clips"], recording.meta["footage"], strict=True):
        if len(recording.meta["clips"]) > 1:
            lines.append(f"clip       {clip['source']}, {clip['frames']} frames")
        lines += _describe_quality(quality)
        lines += [f"warning    {sentence}" for sentence in quality["warnings"]]
    return "\n".join(lines)


def propose_system(
    recording: Recording, *, path: Path, settings: RecordingConfig, crop: Sequence[int] | None
) -> str:
    """Propose a ``conf/system/NAME.yaml`` for this recording; only ``d`` is left to its user.

    ``crop`` (x, y, width, height) [pixel of the rotated video] is the proposed one.
    """
    name = make_name(path.stem).lower() or "film"
    proposed, split = propose_settings(recording, settings), settings.split
    height, width = (proposed.height, proposed.width) if crop is None else fit_frame(crop[3], crop[2])
    model = "\n".join(f"  {key}: {value}" for key, value in IMAGE_MODEL.items())
    kept = settings.crop if crop is None else crop
    images = "" if settings.dt_s is None else f"\n  dt_s: {settings.dt_s:g}"
    return f"""
# @package _global_
# To be kept as conf/system/{name}.yaml of a pipeline (lagsplat init FOLDER), then there:
#   snakemake -c2 results/figures/rollout_{name}.pdf --config hydra="systems=[{name}]"
#   lagsplat fit system={name} out=FOLDER
defaults:
  - override /recording: filmed
  - override /simulation: null

system:
  title: {name.replace("_", " ")}
  film_kind: video
  d: 1 # its number of degrees of freedom, which only you know
{model}

simulation: null

recording:
  path: {str(path.resolve())!r}{images} # spacing of frames: {recording.dt_s:.6g} s
  rotate: {settings.rotate}
  stabilise: {str(proposed.stabilise).lower()}
  grey: {str(settings.grey).lower()}
  crop: {"null" if kept is None else list(kept)} # x, y, width, height, around the motion
  skip_s: {proposed.skip_s:g}
  end_s: {_format_optional(proposed.end_s)}
  height: {height}
  width: {width}
  split:
    train_fraction: {_format_optional(split.train_fraction)}
    held_out_frames: {_format_optional(split.held_out_frames)}
    held_out_clips: {_format_optional(split.held_out_clips)}

chart:
  smoothing_frames: {proposed.smoothing_frames:g} # a twentieth of a period"""


def _format_optional(value: float | None) -> str:
    return "null" if value is None else f"{value:g}"


def _describe_quality(quality: Mapping[str, Any]) -> list[str]:
    camera, flicker, sampling = quality["camera"], quality["flicker"], quality["sampling"]
    texts = {
        "camera": "not measured: too little stands still, or too few frames",
        "exposure": "not measured",
        "period": "not measured",
        "cuts": ", ".join(f"{cut['time_s']:.3f} s" for cut in quality["cuts"]) or "none",
    }
    if camera is not None:
        texts["camera"] = (
            f"moves {camera['rms_px']:.2f} px rms, {camera['max_px']:.2f} px at most (drift "
            f"{camera['drift_px']:.2f}, jitter {camera['jitter_px']:.2f}); limit "
            f"{quality['camera_limit_px']:.2f} px rms of the film"
        )
    if flicker is not None:
        texts["exposure"] = f"{flicker['rms_percent']:.2f} % rms, mostly at {flicker['frequency_hz']:.2f} Hz"
    if sampling is not None:
        texts["period"] = f"{sampling['period_s']:.4g} s, {sampling['samples']:.1f} frames each"
    return [f"{name:<11}{text}" for name, text in texts.items()]
