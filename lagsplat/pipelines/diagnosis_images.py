"""Images of a diagnosed run for its report: where they differ, where the force acts, and a video.

Loads torch, which a diagnosis of trajectories does without.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from lagsplat.diagnose.core.result import Block
from lagsplat.diagnose.diagnosis import DiagnosisRun
from lagsplat.diagnose.imaging.localization import (
    ForceLocalization,
    compute_excess_error,
    describe_image_region,
    localize_force,
)
from lagsplat.diagnose.imaging.rendering import (
    BodyPoints,
    find_body_points,
    find_nearest_frames,
    read_frames,
    render_latents,
)
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.residual.error_budget import forecast_positions
from lagsplat.diagnose.residual.latent_force import LatentForceEstimate
from lagsplat.diagnose.simulators.fitted_run import convert_to_latents
from lagsplat.evaluate.forecast import image_errors
from lagsplat.integer_lists import choose_evenly
from lagsplat.io.recording.recording import Recording
from lagsplat.pipelines.diagnosis_videos import RecordedTrajectory, RecordingPair
from lagsplat.report.diagnosis.content import ImageErrorMap, ImageForceMap, ReportContent, VideoComparison

if TYPE_CHECKING:
    from lagsplat.pipelines.diagnosis_inputs import DiagnosisInputs

MAX_COMPARED_FRAMES = 240  # frames of held-out blocks that are rendered
VIDEO_BLOCKS = 8  # consecutive blocks in the video
MAX_VIDEO_FRAMES = 300  # keeps the report small
MIN_PERIOD_S = 1.0  # duration of a natural period in the video, at least
MAX_FORCE_SAMPLES = 400  # instants at which the force is localized
MIN_FORCE_SHARE = 0.1  # of the rms force: its assumed standard deviation, at least
ERROR_STAGES = ("perception", "chart", "one step", "rollout")


@dataclass(frozen=True)
class RenderedBlocks:
    """Frames (T, H, W, 3) of held-out blocks.

    ``real`` is measured; the others are rendered from the sim's forecast, from the forecast with effects, and
    from the encoded latents ``q`` (T, d).
    """

    q: np.ndarray
    real: np.ndarray
    sim: np.ndarray
    augmented: np.ndarray
    encoded: np.ndarray


def add_images(
    inputs: "DiagnosisInputs", run: DiagnosisRun, content: ReportContent
) -> tuple[DiagnosisRun, ReportContent]:
    """Add the image region and image errors to a diagnosis, and images to the content of its report.

    Recordings that are tables of latents have no images; nothing is added then.
    """
    recordings = inputs.recordings
    assert recordings is not None, "the sim is no fitted run"
    for recorded in recordings.real_recordings:
        blocks = [block for block in run.diagnosis.blocks if block.file == recorded.motion.source]
        if recorded.recording is not None and blocks:
            break
    else:
        return run, content
    period_s, recording = float(run.diagnosis.checks["natural_period_s"]), recorded.recording
    renderer = _BlockRenderer(recordings, inputs.sim.model, run, recorded, recording, blocks, period_s)
    rendered = renderer.render(blocks, MAX_COMPARED_FRAMES)
    excess_error = compute_excess_error(rendered.real, rendered.sim, rendered.encoded)
    place, body = renderer.place()
    where = run.diagnosis.where
    if where is not None:
        points = None if body is None else body.at(rendered.q)
        where = replace(where, image_region=describe_image_region(excess_error, place, points))
    checks = {**run.diagnosis.checks, "image": renderer.image_gap(rendered)}
    worst = int(np.argmax(np.mean((rendered.sim - rendered.real) ** 2, axis=(1, 2, 3))))
    excess = np.maximum(excess_error.map, 0.0)
    content = replace(
        content,
        image_error=ImageErrorMap(_to_bytes(rendered.real[worst]), excess, excess_error.parts),
        image_force=None if place is None or body is None else renderer.map_force(place, body),
        video=renderer.film(),
    )
    return replace(run, diagnosis=replace(run.diagnosis, where=where, checks=checks)), content


@dataclass(frozen=True)
class _BlockRenderer:
    """Renders the held-out blocks of one real recording of a diagnosis."""

    recordings: RecordingPair
    model: MechanicalModel
    run: DiagnosisRun
    recorded: RecordedTrajectory
    recording: Recording
    blocks: Sequence[Block]
    period_s: float  # the natural period

    @property
    def smoothed(self) -> Sequence[LatentForceEstimate]:
        """The real trajectories with the force that the sim lacks; none where that force is not finite."""
        where = self.run.diagnosis.where
        return () if where is None else where.smoothed

    def draw(self, q: np.ndarray) -> np.ndarray:
        """Render states (T, d) as images (T, H, W, 3)."""
        fitted = self.recordings.run
        return render_latents(fitted.autoencoder, fitted.chart, self.latents(q))

    def latents(self, q: np.ndarray) -> np.ndarray:
        """The whitened latents of states (T, d), which are in the coordinates of the law."""
        return convert_to_latents(self.recordings.run.lagrangian, q)

    def render(self, blocks: Sequence[Block], most: int) -> RenderedBlocks:
        """Read and render at most so many frames of blocks."""
        time_s, real, sim, augmented = (
            np.concatenate([getattr(block, name) for block in blocks])
            for name in ("time_s", "real", "sim", "augmented")
        )
        kept = choose_evenly(len(time_s), most)
        frames = read_frames(self.recording, find_nearest_frames(self.recording, time_s[kept]))
        images = (self.draw(q[kept]) for q in (sim, augmented, real))
        return RenderedBlocks(self.latents(real[kept]), frames, *images)

    def image_gap(self, rendered: RenderedBlocks) -> dict[str, Any]:
        """Root mean square image errors: of rendering alone, of the sim's forecast, and with the effects."""
        floor, before, after = (
            float(np.sqrt(np.mean(image_errors(images, rendered.real))))
            for images in (rendered.encoded, rendered.sim, rendered.augmented)
        )
        closure = (before - after) / (before - floor) if before > 1.02 * floor else None
        errors = {"floor": floor, "before": before, "after": after, "closure": closure}
        shares = self._stages(before)
        return errors if shares is None else errors | {"stages": shares}

    def _stages(self, rollout: float) -> dict[str, float] | None:
        """Share of the rollouts' squared error that each stage adds.

        A stage that reduces the error of the one before adds nothing.
        """
        estimate = next((s for s in self.smoothed if s.motion.source == self.recorded.motion.source), None)
        if estimate is None:
            return None
        motion = estimate.motion
        begins = {start for start, _ in motion.segments}
        inside = np.array([i for i in choose_evenly(motion.n, MAX_COMPARED_FRAMES) if i not in begins])
        real = read_frames(self.recording, find_nearest_frames(self.recording, motion.time_s[inside]))
        before = np.stack([inside - 1, inside], axis=1)
        step = forecast_positions(
            self.model,
            estimate.q[inside - 1],
            estimate.v[inside - 1],
            motion.time_s[before],
            motion.u[before],
            finest_s=self.period_s / 50.0,
        )[:, 1]
        stages = (motion.q[inside], estimate.q[inside], step)
        errors = [float(np.mean(image_errors(self.draw(q), real))) for q in stages]
        largest = max(rollout**2, *errors, np.finfo(float).tiny)
        shares = np.maximum(np.diff([0.0, *errors, largest]), 0.0) / largest
        return dict(zip(ERROR_STAGES, shares.tolist(), strict=True))

    @property
    def strongest(self) -> tuple[LatentForceEstimate, np.ndarray]:
        """The trajectory with the largest residual, and the samples at which its force is localized."""
        estimate = max(self.smoothed, key=lambda s: float(np.mean(s.residual**2)))
        return estimate, choose_evenly(estimate.motion.n, MAX_FORCE_SAMPLES)

    def place(self) -> tuple[ForceLocalization | None, BodyPoints | None]:
        """Find the point at which a force explains the residual best; None where there is no residual."""
        if not self.smoothed:
            return None, None
        estimate, at = self.strongest
        if not estimate.active.any():
            return None, None
        fitted = self.recordings.run
        body = find_body_points(fitted.autoencoder, fitted.chart)
        force = estimate.residual[at]
        # a force too small to be detected is not known to be zero
        least = MIN_FORCE_SHARE * float(np.sqrt(np.mean(force**2)))
        covariance = estimate.covariance[at] + least**2 * np.eye(force.shape[1])
        # at the latents' mean, the law's coordinates move as the latents do
        effect_of_force = body.jacobian / self.model.rest_inertia[None, :, None]
        reach = np.broadcast_to(effect_of_force, (len(at), *effect_of_force.shape))
        return localize_force(force, covariance, reach, estimate.v[at]), body

    def map_force(self, place: ForceLocalization, body: BodyPoints) -> ImageForceMap:
        """The force at the instant of its maximum, on the frame of that instant."""
        estimate, at = self.strongest
        main = 0 if place.force is None else int(np.argmax(np.linalg.norm(place.force, axis=1)))
        recording = self.recording
        for recorded in self.recordings.real_recordings:
            if recorded.motion.source == estimate.motion.source and recorded.recording is not None:
                recording = recorded.recording
                break
        frame = read_frames(recording, find_nearest_frames(recording, estimate.motion.time_s[at[[main]]]))[0]
        forces = np.zeros((len(place.explained), 2))
        for number, force in zip(place.near, place.forces, strict=True):
            forces[number] = force[main]
        points = body.at(self.latents(estimate.q[at[[main]]]))[0]
        return ImageForceMap(_to_bytes(frame), points, place.explained, forces, place.near, place.localisable)

    def film(self) -> VideoComparison:
        """A video of consecutive blocks around the one that the sim forecasts worst."""
        worst = int(np.argmax([np.mean((block.sim - block.real) ** 2) for block in self.blocks]))
        first = max(0, min(worst - VIDEO_BLOCKS // 2, len(self.blocks) - VIDEO_BLOCKS))
        blocks = self.blocks[first : first + VIDEO_BLOCKS]
        rendered = self.render(blocks, MAX_VIDEO_FRAMES)
        frames = sum(len(block.time_s) for block in blocks)
        step_s = self.recorded.motion.dt_s * max(1.0, frames / len(rendered.real))
        slowed = max(1.0, MIN_PERIOD_S / self.period_s)
        real, sim, augmented = map(_to_bytes, (rendered.real, rendered.sim, rendered.augmented))
        return VideoComparison(real, sim, augmented, frames_per_s=1.0 / (step_s * slowed), slowed=slowed)


def _to_bytes(picture: np.ndarray) -> np.ndarray:
    return np.round(255.0 * np.clip(picture, 0.0, 1.0)).astype(np.uint8)
