"""Settings that suit a video whose mechanism is not known, from its size and its assessment."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from lagsplat.io.config import RecordingConfig
from lagsplat.io.files.atomic import StrPath
from lagsplat.io.recording.recording import Recording
from lagsplat.io.video.clips import find_clips
from lagsplat.io.video.decode import read_frame_size
from lagsplat.video_quality.frames import make_small_grey
from lagsplat.video_quality.motion_region import find_motion_box, measure_motion

MAX_SIDE_PX = 96  # of a frame: enough for a mechanism on video, and quick to learn
DEFAULT_PERIOD_FRAMES = 20.0  # where no period was measured: smoothing over one frame
SMOOTHED_SHARE = 1 / 20  # of a period
MOST_PIXELS = 20_000_000  # of all frames together in which motion is measured, which bounds memory
CROPPED_SHARE = 0.7  # of the image: a crop that keeps more of it is not proposed
IMAGE_MODEL = {"n_gaussians": "1500", "batch": "8", "encoder_rate": "2e-4"}
"""Settings of ``system`` for a video, as words of YAML and of the command line."""


@dataclass(frozen=True)
class FilmProposal:
    """Proposed settings of ``recording``, and of ``chart.smoothing_frames``."""

    height: int
    width: int
    skip_s: float
    end_s: float | None
    stabilise: bool
    smoothing_frames: float


def fit_frame(height: int, width: int) -> tuple[int, int]:
    """The size (height, width) of a frame in these proportions, its longer side at most `MAX_SIDE_PX`."""
    scale = min(1.0, MAX_SIDE_PX / max(height, width))
    return max(1, round(height * scale)), max(1, round(width * scale))


def choose_frame_size(path: StrPath, settings: RecordingConfig) -> RecordingConfig:
    """The settings with a size of frames that suits the video, unless they have one.

    Raises:
        ValueError: as `read_frame_size`.
    """
    if settings.height is not None:
        return settings
    rows, columns = read_frame_size(find_clips(path)[0], dt_s=settings.dt_s, rotate=settings.rotate)
    if settings.crop is not None:
        columns, rows = settings.crop[2:]
    height, width = fit_frame(rows, columns)
    return replace(settings, height=height, width=width)


def measure_kept_motion(recording: Recording, settings: RecordingConfig) -> Float[np.ndarray, "h w"]:
    """Motion of each pixel [level] in the first clip, from the proposed start to the proposed end."""
    (start, stop), *_ = recording.segments
    proposed = propose_settings(recording, settings)
    time_s = recording.time_s[start:stop] - recording.time_s[start] + settings.skip_s
    kept = (time_s >= proposed.skip_s) & (time_s < (np.inf if proposed.end_s is None else proposed.end_s))
    frames = recording.frames[start:stop][kept]
    return measure_motion(make_small_grey(frames, most=MOST_PIXELS))


def propose_crop(
    recording: Recording, settings: RecordingConfig, motion: Float[np.ndarray, "h w"]
) -> tuple[int, int, int, int] | None:
    """Propose a crop (x, y, width, height) [pixel of the rotated video] around what moves.

    ``motion`` is as of `measure_kept_motion`. None where a crop is set, the camera moves, nothing
    moves, or what moves fills most of the image.
    """
    box = find_motion_box(motion)
    if box is None or settings.crop is not None or propose_settings(recording, settings).stabilise:
        return None
    rows, columns = recording.meta["clips"][0]["picture_px"]
    across, down = columns / motion.shape[1], rows / motion.shape[0]
    x, y, width, height = round(box[0] * across), round(box[1] * down), box[2] * across, box[3] * down
    crop = x, y, min(round(width), columns - x), min(round(height), rows - y)
    return crop if crop[2] * crop[3] < CROPPED_SHARE * rows * columns else None


def propose_settings(recording: Recording, settings: RecordingConfig) -> FilmProposal:
    """Propose settings for a video that was read and assessed with ``settings``, which are kept if set."""
    clips = recording.meta["footage"]
    height, width = settings.height, settings.width
    if height is None or width is None:
        height, width = fit_frame(recording.height, recording.width)
    skips = [clip["skip_s"] for clip in clips if clip["skip_s"] is not None]
    ends = [clip["end_s"] for clip in clips if clip["end_s"] is not None]
    cameras = [(clip["camera"], clip["camera_limit_px"]) for clip in clips if clip["camera"] is not None]
    skip_s = max([settings.skip_s, *skips])
    samples = [clip["sampling"]["samples"] for clip in clips if clip["sampling"] is not None]
    return FilmProposal(
        height=height,
        width=width,
        skip_s=skip_s,
        end_s=min([end for end in ends if end > skip_s], default=settings.end_s),
        stabilise=settings.stabilise or any(camera["rms_px"] > limit for camera, limit in cameras),
        smoothing_frames=float(f"{SMOOTHED_SHARE * min(samples, default=DEFAULT_PERIOD_FRAMES):.2g}"),
    )
