"""Checks of a recording's images: a camera that moved, and frames that cannot be used."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float64

from lagsplat.chart.chart import Chart
from lagsplat.diagnose.core.config import VIDEO_CHECKS
from lagsplat.diagnose.core.result import Finding
from lagsplat.io.recording.recording import Recording
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.video_quality.assessment import CAMERA_PX
from lagsplat.video_quality.camera_motion import measure_path, track_background
from lagsplat.video_quality.frames import make_small_grey


@dataclass(frozen=True)
class CameraShift:
    """How far the camera moved [pixel of a frame]; None where no background shows it."""

    within_px: float | None  # rms during the recording
    between_px: tuple[float, float] | None  # (x, y) since the recording that the simulator was fitted to
    share: float  # change of a latent that the larger of both causes, over its standard deviation

    @property
    def still_within(self) -> bool:
        """Whether the camera is known to have stood still during the recording."""
        return self.within_px is not None and self.within_px <= CAMERA_PX

    @property
    def still_between(self) -> bool:
        """Whether the camera is known to have stood where it was for the nominal recording."""
        return self.between_px is not None and float(np.hypot(*self.between_px)) <= CAMERA_PX


def measure_camera_shift(
    recording: Recording, nominal: Recording, autoencoder: Autoencoder, chart: Chart
) -> CameraShift:
    """Measure the camera's motion by the background of two recordings."""
    within = _measure_within(recording)
    between = _measure_between(recording, nominal)
    far = max(within or 0.0, float(np.hypot(*(between or (0.0, 0.0)))))
    share = _measure_latent_shift(recording, autoencoder, chart, far) if far > CAMERA_PX else 0.0
    return CameraShift(within, between, share)


def check_camera(shift: CameraShift, *, source: str) -> list[Finding]:
    """Report a camera that moved; no finding where it stood still or cannot be measured."""
    motions = []
    if shift.within_px is not None and not shift.still_within:
        motions.append(f"by {shift.within_px:.2f} px rms during the recording")
    if shift.between_px is not None and not shift.still_between:
        x, y = shift.between_px
        motions.append(f"by ({x:+.2f}, {y:+.2f}) px since the recording the sim was learnt from")
    if not motions:
        return []
    what = f"the camera moved {' and '.join(motions)} (pixels of a frame, measured on the background)"
    why = (
        f"the encoder reads such a shift as motion of up to {100 * shift.share:.2g} % of the motion's "
        "spread, which passes for a force or an offset"
    )
    remedy = "film from a tripod that stays where it is, or fit the run with recording.stabilise=true"
    return [Finding("warn", "camera moved", source, what, why, remedy)]


def drop_unusable_frames(recording: Recording) -> tuple[Recording, list[Finding]]:
    """Keep the frames between foreign objects, cuts and repetitions, with a finding for all that is left out.

    Nothing is continued across a cut. Clips that become too short are dropped, unless none would be left.
    """
    footage = recording.meta.get("footage") or []
    source = str(recording.meta.get("source", "recording"))
    if len(footage) != len(recording.segments):
        return recording, []
    findings: list[Finding] = []
    pieces: list[tuple[int, int]] = []
    for clip, assessment in zip(recording.segments, footage, strict=True):
        findings += _report_clip(assessment, source)
        pieces += _select_pieces(recording.time_s, clip, assessment)
    if not pieces or tuple(pieces) == recording.segments:
        return recording, findings
    return recording.pieces(pieces), findings


def _select_pieces(
    time_s: Float64[np.ndarray, " T"], clip: tuple[int, int], assessment: Mapping[str, Any]
) -> list[tuple[int, int]]:
    """What of a clip is kept; times in ``assessment`` count from the first frame of the video."""
    start, stop = clip
    video_time_s = time_s[start:stop] - time_s[start] + assessment["start_s"]
    repeat, visit = assessment["repeat"] or {}, assessment["visit"] or {}
    ends_s = [end_s for end_s in (repeat.get("start_s"), visit.get("back_s")) if end_s is not None]
    stop = start + int(np.sum(video_time_s < min(ends_s, default=np.inf)))
    if visit.get("gone_s") is not None:
        start += int(np.sum(video_time_s < visit["gone_s"]))
    cuts = [clip[0] + int(np.searchsorted(video_time_s, cut["time_s"] - 1e-6)) for cut in assessment["cuts"]]
    borders = [start, *(cut for cut in sorted(cuts) if start < cut < stop), stop]
    kept = [(a, b) for a, b in pairwise(borders) if b - a >= VIDEO_CHECKS.min_clip_frames]
    return kept or [clip]


def _report_clip(assessment: Mapping[str, Any], source: str) -> list[Finding]:
    """Findings of one clip's assessment, except the camera's motion."""
    findings = []

    def add(check: str, what: str, why: str, remedy: str) -> None:
        findings.append(Finding("warn", check, source, what, why, remedy))

    for cut in assessment["cuts"]:
        what = f"the film jumps at {cut['time_s']:.3f} s"
        add("cut", what, "nothing is continued across a cut", "give the takes as films of their own")
    if repeat := assessment["repeat"]:
        what = f"the film repeats itself from {repeat['start_s']:.2f} s on"
        add(
            "repetition", what, "what was seen before says nothing new, and is left out", "cut the film there"
        )
    for when, edge in (("until", "gone_s"), ("from", "back_s")):
        if (visit := assessment["visit"]) and visit[edge] is not None:
            foreign = "something that does not belong to the motion, a hand perhaps,"
            what = f"{foreign} is in the picture {when} {visit[edge]:.2f} s"
            add("visitor", what, "that part is left out", "cut it off")
    for check, word, begins in (
        ("flicker", "Lock the camera's exposure", "the exposure flickers"),
        ("sampling", "Film with a higher frame rate", "only "),
    ):
        for sentence in assessment["warnings"]:
            if sentence.startswith(begins):
                what, _, _ = sentence.partition(word)
                head, _, tail = what.rstrip(". ").partition("; ")
                add(check, head, tail or "what is read off such pictures is poor", word.lower())
    return findings


def _measure_within(recording: Recording) -> float | None:
    """Rms of the image's motion [pixel of a frame], from the video's assessment or from the frames."""
    footage: Sequence[Mapping[str, Any]] = recording.meta.get("footage") or ()
    if footage:
        assessed = [clip for clip in footage if clip["camera"] is not None]
        # The limit is CAMERA_PX of a frame, in pixels of the video.
        sizes = [CAMERA_PX * clip["camera"]["rms_px"] / clip["camera_limit_px"] for clip in assessed]
        return max(sizes, default=None)
    paths = []
    for start, stop in recording.segments:
        stride = -(-(stop - start) // VIDEO_CHECKS.max_frames)
        images = make_small_grey(np.asarray(recording.frames[start:stop:stride]), most=10**9)
        path = track_background([image.astype(np.uint8) for image in images])
        if path is not None and np.isfinite(path).any():
            paths.append(measure_path(path).rms_px * recording.width / images.shape[2])
    return max(paths, default=None)


def _measure_between(recording: Recording, nominal: Recording) -> tuple[float, float] | None:
    """How far the background moved between two recordings [pixel of a frame]; None without background."""
    grey = [cv2.cvtColor(_compute_median_image(each), cv2.COLOR_RGB2GRAY) for each in (nominal, recording)]
    path = track_background(grey)
    if path is None or not np.isfinite(path).all():
        return None
    x, y = path[1].mean(axis=0)
    return float(x), float(y)


def _compute_median_image(recording: Recording) -> np.ndarray:
    """The median image, uint8 (H, W, 3), in which nothing moves."""
    stride = -(-recording.n_frames // VIDEO_CHECKS.max_frames)
    return np.round(np.median(np.asarray(recording.frames[::stride]), axis=0)).astype(np.uint8)


def _measure_latent_shift(
    recording: Recording, autoencoder: Autoencoder, chart: Chart, far_px: float
) -> float:
    """Largest mean change of a whitened latent when images are shifted by ``far_px`` along x or y."""
    chosen = np.linspace(0, recording.n_frames - 1, VIDEO_CHECKS.shifted_frames).astype(int)
    frames = recording.frames[chosen]
    q = chart.encode(autoencoder, frames)
    changes = []
    for x, y in ((far_px, 0.0), (0.0, far_px)):
        matrix = np.array([[1.0, 0.0, x], [0.0, 1.0, y]])
        size = frames.shape[2], frames.shape[1]
        shifted = [cv2.warpAffine(frame, matrix, size, borderMode=cv2.BORDER_REPLICATE) for frame in frames]
        moved = chart.encode(autoencoder, np.stack(shifted))
        changes.append(np.abs(moved - q).mean(axis=0).max())
    return float(max(changes))
