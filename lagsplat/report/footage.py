"""What a film's own checks found, in words, and the configuration that follows from it."""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lagsplat.io.config import RecordingConfig
from lagsplat.io.recording import Recording

LONGEST_SIDE = 96  # pixels of a frame: enough for a filmed mechanism, and quick to learn
NO_PERIOD = 20.0  # frames a period where none was found: smoothing over one frame


def describe_footage(recording: Recording) -> str:
    """The numbers of ``recording.meta["footage"]``, a block of lines for each clip."""
    lines = []
    for clip, found in zip(recording.meta["clips"], recording.meta["footage"], strict=True):
        if len(recording.meta["clips"]) > 1:
            lines.append(f"clip       {clip['source']}, {clip['frames']} frames")
        lines += _measured(found)
        lines += [f"warning    {sentence}" for sentence in found["warnings"]]
    return "\n".join(lines)


def propose_system(recording: Recording, *, path: Path, settings: RecordingConfig) -> str:
    """A ``conf/system/NAME.yaml`` for this recording, ready to be pasted; only ``d`` is left to its user."""
    name = re.sub(r"\W+", "_", path.stem).strip("_").lower() or "film"
    found = recording.meta["footage"]
    height, width = _size(recording, settings)
    crop = "null" if settings.crop is None else str(list(settings.crop))
    skips = [clip["skip_s"] for clip in found if clip["skip_s"] is not None]
    ends = [clip["end_s"] for clip in found if clip["end_s"] is not None]
    shakes = any(
        clip["camera"] is not None and clip["camera"]["rms_px"] > clip["camera_limit_px"] for clip in found
    )
    skip_s = max([settings.skip_s, *skips])
    end_s = min([end for end in ends if end > skip_s], default=settings.end_s)
    split = settings.split
    samples = [clip["sampling"]["samples"] for clip in found if clip["sampling"] is not None]
    smoothing = min(samples, default=NO_PERIOD) / 20
    images = "" if settings.dt_s is None else f"\n  dt_s: {settings.dt_s:g}"
    return f"""
# @package _global_
# To be kept as conf/system/{name}.yaml, then: lagsplat fit system={name} out=FOLDER
defaults:
  - override /recording: filmed
  - override /simulation: null

system:
  title: {name.replace("_", " ")}
  film: video
  d: 1 # its number of degrees of freedom, which only you know
  n_gaussians: 1500
  batch: 8
  encoder_rate: 2e-4

simulation: null

recording:
  path: {str(path)!r}{images} # spacing of frames: {recording.dt_s:.6g} s
  rotate: {settings.rotate}
  stabilise: {str(settings.stabilise or shakes).lower()}
  grey: {str(settings.grey).lower()}
  crop: {crop} # x, y, width, height, tight around the motion
  skip_s: {skip_s:g}
  end_s: {"null" if end_s is None else f"{end_s:g}"}
  height: {height}
  width: {width}
  split:
    train_fraction: {_given(split.train_fraction)}
    held_out_frames: {_given(split.held_out_frames)}
    held_out_clips: {_given(split.held_out_clips)}

chart:
  smoothing_frames: {smoothing:.2g} # a twentieth of a period"""


def _given(value: float | None) -> str:
    return "null" if value is None else f"{value:g}"


def _size(recording: Recording, settings: RecordingConfig) -> tuple[int, int]:
    """Height and width [pixel] in the proportions of what is kept, as given or at most 96 a side."""
    if settings.height is not None and settings.width is not None:
        return settings.height, settings.width
    longest = max(recording.height, recording.width)
    scale = min(1.0, LONGEST_SIDE / longest)
    return max(1, round(recording.height * scale)), max(1, round(recording.width * scale))


def _measured(found: Mapping[str, Any]) -> list[str]:
    camera, flicker, sampling = found["camera"], found["flicker"], found["sampling"]
    unknown = "not measured"
    cuts = ", ".join(f"{cut['time_s']:.3f} s" for cut in found["cuts"])
    return [
        "camera     "
        + (
            f"{unknown}: too little stands still, or too few frames"
            if camera is None
            else f"moves {camera['rms_px']:.2f} px rms, {camera['max_px']:.2f} px at most (drift "
            f"{camera['drift_px']:.2f}, jitter {camera['jitter_px']:.2f}); limit "
            f"{found['camera_limit_px']:.2f} px rms of the film"
        ),
        "exposure   "
        + (
            unknown
            if flicker is None
            else f"{flicker['rms_percent']:.2f} % rms, mostly at {flicker['frequency_hz']:.2f} Hz"
        ),
        "period     "
        + (
            unknown
            if sampling is None
            else f"{sampling['period_s']:.4g} s, {sampling['samples']:.1f} frames each"
        ),
        f"cuts       {cuts or 'none'}",
    ]
