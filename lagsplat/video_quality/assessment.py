"""Assess whether a video suits the method: each defect measured, with a warning and a remedy."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, UInt8

from lagsplat.video_quality import continuity
from lagsplat.video_quality.camera_motion import CameraMotion, measure_path, track_background
from lagsplat.video_quality.frames import Thumbnails, make_small_grey

LEAST_FRAMES = 24
MOST_PIXELS = 20_000_000  # of all small frames together
CAMERA_PX = 0.25  # camera rms [pixel of a frame] that would disturb a fit...
CAMERA_ERROR = 0.1  # ...and rms [pixel of a thumbnail] that can be measured
FLICKER_PERCENT = 2.0
SAMPLES, NYQUIST_SAMPLES = 8.0, 3.0
SAME_S = 0.1  # a foreign object that leaves this close to a cut is the same event...
CUT_SHARE = 0.25  # ...which is a cut if it changes more of the still pixels than this


@dataclass(frozen=True)
class ForeignObject:
    """An object in view at the start or the end of a video."""

    gone_s: float | None  # when it leaves; None: not in view at the start
    back_s: float | None  # when it comes; None: not in view at the end
    share: float  # of the otherwise still pixels that it covers at most


@dataclass(frozen=True)
class VideoAssessment:
    """Measurements of one clip, None where impossible. Times [s] count from the clip's first frame.

    Camera motion refers to the whole image, everything else to the frames as kept.
    """

    camera: CameraMotion | None
    flicker: continuity.ExposureFlicker | None
    cuts: tuple[continuity.SceneCut, ...]
    repeat: continuity.LoopRepeat | None
    visit: ForeignObject | None
    sampling: continuity.SamplingRate | None
    camera_limit_px: float  # largest acceptable rms of the camera motion [pixel of the video]
    start_s: float
    stop_s: float

    @property
    def numbers(self) -> dict[str, Any]:
        """All measurements and conclusions as plain data, for a recording's ``meta``."""
        suggested = {"skip_s": self.skip_s, "end_s": self.end_s, "warnings": list(self.warnings)}
        return {**asdict(self), "cuts": [asdict(cut) for cut in self.cuts], **suggested}

    @property
    def skip_s(self) -> float | None:
        """Where to start, after an early cut or foreign object; None keeps the start."""
        begins = [cut.time_s for cut in self.cuts if not self._late(cut)]
        if self.visit is not None and self.visit.gone_s is not None:
            begins.append(self.visit.gone_s)
        return math.ceil(100 * max(begins) - 1e-6) / 100 if begins else None

    @property
    def end_s(self) -> float | None:
        """Where to stop, before a late cut, repetition or foreign object; None keeps the end."""
        ends = [cut.time_s for cut in self.cuts if self._late(cut)]
        if self.repeat is not None:
            ends.append(self.repeat.start_s)
        if self.visit is not None and self.visit.back_s is not None:
            ends.append(self.visit.back_s)
        return math.floor(100 * min(ends) + 1e-6) / 100 if ends else None

    @property
    def warnings(self) -> tuple[str, ...]:
        """A sentence for each defect, with its numbers and the remedy."""
        camera, flicker, repeat, visit = self.camera, self.flicker, self.repeat, self.visit
        sentences = []
        if camera is not None and camera.rms_px > self.camera_limit_px:
            sentences.append(
                f"the camera moves by {camera.rms_px:.2f} px rms and up to {camera.max_px:.2f} px of the "
                f"film (drift {camera.drift_px:.2f}, jitter {camera.jitter_px:.2f}), measured on the "
                f"background; more than {self.camera_limit_px:.2f} px rms will be learned as motion of the "
                "system. Set recording.stabilise=true, or film from a tripod"
            )
        if flicker is not None and flicker.rms_percent > FLICKER_PERCENT:
            sentences.append(
                f"the exposure flickers by {flicker.rms_percent:.1f} % rms, mostly at "
                f"{flicker.frequency_hz:.2f} Hz; above {FLICKER_PERCENT:g} % colours change more than they "
                "are learned to. Lock the camera's exposure, or cut to a steady part with recording.skip_s "
                "and end_s"
            )
        for cut in self.cuts:
            side = f"end_s={self.end_s:g}" if self._late(cut) else f"skip_s={self.skip_s:g}"
            sentences.append(
                f"the film jumps at {cut.time_s:.3f} s: that frame differs {cut.ratio:.1f} times as much as "
                f"those around it. Keep one side: set recording.{side}"
            )
        if repeat is not None:
            sentences.append(
                f"the film repeats itself: from {repeat.start_s:.2f} s to {repeat.stop_s:.2f} s its frames "
                f"are those from {repeat.original_s:.2f} s on, so that nothing new is held out. Set "
                f"recording.end_s={self.end_s:g}"
            )
        stranger = "something that does not belong to the motion, a hand perhaps,"
        if visit is not None and visit.gone_s is not None:
            sentences.append(
                f"{stranger} is in the picture until {visit.gone_s:.2f} s and covers up to "
                f"{100 * visit.share:.1f} % of what is still later. Set recording.skip_s={self.skip_s:g}"
            )
        if visit is not None and visit.back_s is not None:
            into = f"{stranger} comes into the picture at {visit.back_s:.2f} s"
            sentences.append(f"{into}. Set recording.end_s={self.end_s:g}")
        return (*sentences, *self._warn_of_few_samples())

    def _late(self, cut: continuity.SceneCut) -> bool:
        return cut.time_s > 0.5 * (self.start_s + self.stop_s)

    def _warn_of_few_samples(self) -> list[str]:
        if self.sampling is None or self.sampling.samples >= SAMPLES:
            return []
        rate = f"only {self.sampling.samples:.1f} frames a period of {self.sampling.period_s:.4g} s"
        if self.sampling.samples < NYQUIST_SAMPLES:
            return [
                f"{rate}, near the Nyquist limit of 2: the true motion may be faster than it looks. Film "
                "with a higher frame rate; what is learned from this film cannot be trusted"
            ]
        poor = f"velocities from so few are poor, and {SAMPLES:g} or more are wanted"
        return [f"{rate}; {poor}. Film with a higher frame rate"]


def assess_video(
    frames: UInt8[np.ndarray, "T H W 3"],
    time_s: continuity.Times,
    thumbnails: Thumbnails,
    *,
    crop: Sequence[int] | None = None,
) -> VideoAssessment:
    """Measure one clip in at most a few seconds; under 24 frames it is too short for any check.

    ``time_s`` [s] counts from the clip's first frame. ``thumbnails`` show the whole images, of which
    ``crop`` (x, y, width, height) [pixel], or all if None, became ``frames``.
    """
    width = thumbnails.width if crop is None else crop[2]
    limit = max(CAMERA_PX * max(1.0, width / frames.shape[2]), CAMERA_ERROR * thumbnails.scale)
    start_s, stop_s = float(time_s[0]), float(time_s[-1])
    if len(frames) < LEAST_FRAMES:
        return VideoAssessment(None, None, (), None, None, None, limit, start_s, stop_s)
    path = track_background(thumbnails.pictures)
    camera = None if path is None else measure_path(path * thumbnails.scale)
    grey = make_small_grey(frames, most=MOST_PIXELS)
    cuts = continuity.find_scene_cuts(grey, time_s)
    gain = continuity.measure_exposure_gain(grey)
    if gain is not None:
        grey /= gain[:, None, None].astype(np.float32)
    moves = camera is not None and camera.rms_px > limit
    # A moving camera covers and uncovers every pixel.
    visit = None if moves else find_foreign_object(grey, time_s)
    cuts, visit = (cuts, None) if visit is None else _cut_or_visit(cuts, visit)
    return VideoAssessment(
        camera=camera,
        flicker=None if gain is None else continuity.find_exposure_flicker(gain, time_s),
        cuts=cuts,
        repeat=continuity.find_loop(grey, time_s),
        visit=visit,
        sampling=continuity.measure_samples_per_period(grey, time_s),
        camera_limit_px=limit,
        start_s=start_s,
        stop_s=stop_s,
    )


def _cut_or_visit(
    cuts: tuple[continuity.SceneCut, ...], visit: ForeignObject
) -> tuple[tuple[continuity.SceneCut, ...], ForeignObject | None]:
    """Classify one event as either: a cut changes most of the image, a foreign object a part of it."""
    borders = [time_s for time_s in (visit.gone_s, visit.back_s) if time_s is not None]
    others = tuple(cut for cut in cuts if all(abs(cut.time_s - border) >= SAME_S for border in borders))
    if len(others) < len(cuts) and visit.share > CUT_SHARE:
        return cuts, None
    return others, visit


LATER = (0.4, 0.8)  # the reference stretch of the video, as shares of its frames
LEVELS = 12.0  # a pixel is an outlier if it differs by this many of 255 levels...
SPREADS = 6.0  # ...and by this many standard deviations of the reference stretch
SHARE = 0.002  # of the still pixels must be outliers at once
STAYING = 0.98  # of the time some of them are outliers; a swing uncovers each of its pixels twice a period
LARGEST = 0.5  # a foreign object stays at most this share of the video


def find_foreign_object(grey: continuity.Grey, time_s: continuity.Times) -> ForeignObject | None:
    """Find what covers still pixels at the start or end of a video, such as a hand that lets go.

    ``grey`` should be free of flicker. Where the system itself moves in mid-video no pixel is still, so a
    hand that touches only there is missed. What covers pixels now and then, as a system does that later comes
    to rest, is no foreign object: one stays over some of them.
    """
    usual_part = grey[int(LATER[0] * len(grey)) : int(LATER[1] * len(grey))]
    usual, spread = np.median(usual_part, axis=0), usual_part.std(axis=0)
    moving = np.ptp(usual_part, axis=0) > LEVELS + SPREADS * float(np.median(spread))
    # A decaying motion was wider at the start, so pixels around it do not count.
    margin = max(3, max(grey.shape[1:]) // 12)
    still = cv2.dilate(moving.astype(np.uint8), np.ones((2 * margin + 1,) * 2, np.uint8)) == 0
    if still.mean() < 0.05:
        return None
    limit = np.maximum(LEVELS, SPREADS * spread[still])
    hidden = np.array([np.abs(frame[still] - usual[still]) > limit for frame in grey])
    covered = hidden.mean(axis=1)
    there = covered > SHARE
    most = int(LARGEST * len(grey))
    found = (_leading(there), hidden), (_leading(there[::-1]), hidden[::-1])
    start, end = (n if n <= most and _stays(pixels[:n]) else 0 for n, pixels in found)
    if not start and not end:
        return None
    share = max(covered[:start].max(initial=0.0), covered[len(covered) - end :].max(initial=0.0))
    return ForeignObject(
        gone_s=float(time_s[start]) if start else None,
        back_s=float(time_s[len(grey) - end]) if end else None,
        share=float(share),
    )


def _stays(hidden: Bool[np.ndarray, "T n"]) -> bool:
    """Whether something hides the same pixels all the time, but for the last quarter, when it may leave."""
    if not len(hidden):
        return False
    lasting = hidden[: max(1, 3 * len(hidden) // 4)].mean(axis=0) >= STAYING
    return bool(lasting.mean() > SHARE)


def _leading(there: Bool[np.ndarray, " T"]) -> int:
    """Frames up to the last of the event that holds the first frame; short gaps are part of it."""
    if not there[:3].any():
        return 0
    absent = np.flatnonzero(np.convolve(there, np.ones(6), mode="full")[5:] == 0)
    return int(absent[0]) if len(absent) else len(there)
