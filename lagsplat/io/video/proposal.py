"""Settings that suit a video whose mechanism is not known, from its size and its assessment."""

from dataclasses import dataclass

from lagsplat.io.config import RecordingConfig
from lagsplat.io.recording.recording import Recording

MAX_SIDE_PX = 96  # of a frame: enough for a mechanism on video, and quick to learn
DEFAULT_PERIOD_FRAMES = 20.0  # where no period was measured: smoothing over one frame
SMOOTHED_SHARE = 1 / 20  # of a period
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
