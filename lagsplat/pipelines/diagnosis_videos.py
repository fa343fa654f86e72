"""A fitted run as the simulator, and the recordings it is compared with, in the coordinates of its law."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from lagsplat.chart.names import name_coordinates
from lagsplat.diagnose.core.config import VIDEO_CHECKS
from lagsplat.diagnose.core.result import Diagnosis, Finding
from lagsplat.diagnose.effects.registry import catalogue, list_effects
from lagsplat.diagnose.imaging.rendering import compute_decoding_errors
from lagsplat.diagnose.imaging.video_checks import CameraShift, check_camera, measure_camera_shift
from lagsplat.diagnose.residual.error_budget import PerceptionQuality, assess_perception
from lagsplat.diagnose.simulators.fitted_run import convert_to_law, read_chart_trajectory
from lagsplat.integer_lists import choose_evenly
from lagsplat.io.read import read_trajectory
from lagsplat.io.recording.recording import Recording
from lagsplat.io.sources import DataSource, find_sources
from lagsplat.io.trajectory.trajectory import Trajectory, leading_samples
from lagsplat.pipelines.real_videos import check_inputs, read_fitted_settings, read_real_video
from lagsplat.runs.run import FittedRun, open_run

HELD_OUT = "held_out"  # names the held-out part of a run's own recording
MOVED = (
    "moves while recording",
    "moved between recordings",
)  # what effects are about that the background rules out


@dataclass(frozen=True)
class RecordingPair:
    """A run with its training part and the real recordings, all in the coordinates of its law.

    ``same_recording``: the real one is the held-out part of the very recording the run was fitted to.
    """

    run: FittedRun
    nominal: tuple[Trajectory, ...]
    real_recordings: tuple["RecordedTrajectory", ...]
    same_recording: bool

    @property
    def real(self) -> tuple[Trajectory, ...]:
        """The real trajectories in the coordinates of the law."""
        return tuple(recorded.motion for recorded in self.real_recordings)

    @cached_property
    def image_quality(self) -> "ImageQuality | None":
        """Reconstruction errors of the real images and the place of their latents; None without images.

        They are compared with the held-out part of the run's own recording, or with its training part where
        the held-out part is diagnosed.
        """
        videos = [r.recording for r in self.real_recordings if r.recording is not None]
        if not videos:
            return None
        train, held_out = self.run.recording.split()
        reference = train if self.same_recording else held_out
        nominal, *others = (
            compute_decoding_errors(self.run.autoencoder, self.run.chart, video)
            for video in (reference, *videos)
        )
        real = np.concatenate(others)
        latents = np.concatenate([motion.q for motion in self.real])
        seen = self.nominal[0].q[choose_evenly(self.nominal[0].n, VIDEO_CHECKS.max_latents)]
        return ImageQuality(real, nominal, assess_perception(real, nominal, latents, seen))

    def judge(self, diagnosis: Diagnosis) -> Diagnosis:
        """Add to a diagnosis what the images say about it.

        It is conditional on perception where the real images are reconstructed worse than the nominal ones,
        or have latents outside of theirs. It is undetermined where they are reconstructed so badly that the
        states are unknown, and where motion of the camera explains half of the gap but no camera effect is
        named.
        """
        known, warned, checks = catalogue(), list(diagnosis.warnings), dict(diagnosis.checks)
        cameras = {known[name].camera for name in diagnosis.combination}
        if self.image_quality is not None:
            seen = self.image_quality.perception
            worse = f"the real images are reconstructed {seen.ratio:.2g} times as badly as the run's own"
            checks |= {
                "drawn_over_nominal": seen.ratio,
                "outside_nominal": seen.outside,
                "conditional_on_perception": seen.suspect,
            }
            if seen.suspect:
                warned.append(
                    f"conditional on perception: {worse}, and {100 * seen.outside:.2g} % of the frames lie "
                    "where it was never trained; what follows holds only if the encoder is right there"
                )
            unreadable = seen.ratio > VIDEO_CHECKS.unreadable_error_ratio
            if unreadable and diagnosis.verdict != "none" and not cameras - {None}:
                checks["undetermined"] = [
                    f"{worse}, so the encoder cannot read their states; record with the same camera and "
                    "compression"
                ]
        gap = diagnosis.gap.before if diagnosis.gap is not None else np.inf
        moved = self.camera_share > VIDEO_CHECKS.max_camera_share * gap
        if moved and cameras and not cameras & set(MOVED):
            checks["undetermined"] = [
                f"the camera moved, which alone imitates {100 * self.camera_share:.2g} % of the motion's "
                f"size while the gap is {100 * gap:.2g} %; no effect can be separated from that"
            ]
        return replace(diagnosis, warnings=tuple(warned), checks=checks)

    @property
    def null_motion(self) -> Trajectory:
        """A trajectory without any effect: the held-out part of the run's own recording, or its training part
        where the held-out part is diagnosed."""
        return self.nominal[0] if self.same_recording else _read_own_part(self.run, held_out=True)

    @property
    def ruled_out(self) -> tuple[str, ...]:
        """Camera effects that the background rules out, because it does not move in any video.

        A camera that is still during the run's own recording did not move between its two parts either.
        """
        shifts = [recorded.camera for recorded in self.real_recordings]
        still_within = all(shift is not None and shift.still_within for shift in shifts)
        still_between = still_within and self.same_recording
        still_between = still_between or all(shift is not None and shift.still_between for shift in shifts)
        impossible = (MOVED[0],) * still_within + (MOVED[1],) * still_between
        return tuple(effect.name for effect in list_effects() if effect.camera in impossible)

    @property
    def camera_share(self) -> float:
        """Motion of the camera, as a share of the standard deviation of a latent, at most."""
        cameras = [recorded.camera for recorded in self.real_recordings]
        return max((shift.share for shift in cameras if shift is not None), default=0.0)


@dataclass(frozen=True)
class ImageQuality:
    """Mean square reconstruction errors of real frames (T,) and nominal frames (N,), and their comparison."""

    error_real: np.ndarray
    error_nominal: np.ndarray
    perception: PerceptionQuality


@dataclass(frozen=True)
class RecordedTrajectory:
    """One real trajectory; its ``recording`` and ``camera`` are None for a table of latents."""

    motion: Trajectory
    recording: Recording | None = None
    camera: CameraShift | None = None
    findings: tuple[Finding, ...] = ()


def open_recording_pair(
    folder: Path, real: str, *, columns: Mapping[str, str] | None = None, longest_s: float = np.inf
) -> RecordingPair:
    """Open the run in ``folder`` and the videos, logs or tables of latents that ``real`` names.

    Videos and logs are rotated, cropped and resized as the run's own recording was, but not cut in time as it
    was. Their inputs are in a table of the same stem, unless they contain them. ``held_out``, the run's own
    video and its ``recording.safetensors`` name the held-out part of its own recording, of which the first
    ``longest_s`` [s] are used. ``columns`` are as of `read_trajectory`.

    Raises:
        FileNotFoundError: no run, or nothing where ``real`` points.
        ValueError: a file that cannot be read, the run's own recording beside others, a model, or a number of
            latents, inputs or pixels that is not the run's.
    """
    run = open_run(folder)
    nominal = (_read_own_part(run, held_out=False),)
    sources = () if real == HELD_OUT else find_sources(real)
    recorded = [_read_trajectory(folder, run, source, columns) for source in sources]
    others = tuple(each for each in recorded if each is not None)
    if not others:
        motion = leading_samples(_read_own_part(run, held_out=True), longest_s)
        train, held_out = run.recording.split()
        shift = measure_camera_shift(held_out, train, run.autoencoder, run.chart)
        findings = tuple(check_camera(shift, source=motion.source))
        own = RecordedTrajectory(motion, held_out, shift, findings)
        return RecordingPair(run, nominal, (own,), same_recording=True)
    if len(others) < len(recorded):
        raise ValueError(
            f"real={real}: some of these are the recording the run was fitted to, and others are not; give "
            "one kind at a time"
        )
    return RecordingPair(run, nominal, others, same_recording=False)


def _read_own_part(run: FittedRun, *, held_out: bool) -> Trajectory:
    return _adopt(read_chart_trajectory(run.chart, held_out=held_out), run)


def _read_trajectory(
    folder: Path, run: FittedRun, source: DataSource, columns: Mapping[str, str] | None
) -> RecordedTrajectory | None:
    """Read one real trajectory with its frames; None where it is the run's own recording."""
    if source.kind == "trajectory":
        motion = read_trajectory(source.path, columns=columns)
        _check_latents(run, motion, source.path)
        return RecordedTrajectory(_adopt(motion, run))
    read = read_real_video(source, run.recording, read_fitted_settings(folder), dt_s=run.chart.dt_s)
    if read is None:
        return None
    recording, findings = read
    shift = measure_camera_shift(recording, run.recording.split()[0], run.autoencoder, run.chart)
    findings += check_camera(shift, source=Path(source.path).name)
    latents = run.chart.encode(run.autoencoder, recording.frames)
    motion = Trajectory(
        time_s=recording.time_s,
        q=latents,
        u=recording.inputs,
        segments=recording.segments,
        source=Path(source.path).name,
    )
    return RecordedTrajectory(_adopt(motion, run), recording, shift, tuple(findings))


def _check_latents(run: FittedRun, motion: Trajectory, source: str) -> None:
    d, n_u = run.chart.d, run.chart.inputs.shape[1]
    if motion.d != d:
        raise ValueError(
            f"{source}: {motion.d} coordinate(s), but the run has {d} whitened latent(s); give a video, or "
            "latents that this run's autoencoder encoded"
        )
    check_inputs(source, motion.n_u, n_u)


def _adopt(motion: Trajectory, run: FittedRun) -> Trajectory:
    """A trajectory of latents in the coordinates of the run's law; names are the run's."""
    names = run.recording.input_names
    u_names = (*names[: motion.n_u], *(f"u{i}" for i in range(len(names), motion.n_u)))
    q = convert_to_law(run.lagrangian, motion.q)
    return replace(motion, q=q, q_names=name_coordinates(motion.d), u_names=u_names)
