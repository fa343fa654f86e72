"""Images of a diagnosed run for its report: where they differ, where the force acts, and a video.

Loads torch, which a diagnosis of trajectories does without.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
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
    choose_evenly,
    find_body_points,
    find_nearest_frames,
    read_frames,
    render_latents,
)
from lagsplat.diagnose.mechanics.model import compute_rest_inertia
from lagsplat.diagnose.residual.error_budget import compute_stage_shares, forecast_positions
from lagsplat.diagnose.residual.latent_force import LatentForceEstimate
from lagsplat.evaluate.forecast import image_errors
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


@dataclass(frozen=True)
class RenderedBlocks:
    """Frames (T, H, W, 3) of held-out blocks.

    ``real`` is measured; the others are rendered from the sim's forecast, from the forecast with effects, and
    from the encoded latents ``q`` (T, d). ``at`` (T,) are the numbers of the frames.
    """

    recorded: RecordedTrajectory
    at: np.ndarray
    q: np.ndarray
    real: np.ndarray
    sim: np.ndarray
    augmented: np.ndarray
    encoded: np.ndarray


def build_image_content(inputs: "DiagnosisInputs", found: DiagnosisRun) -> tuple[DiagnosisRun, ReportContent]:
    """Add the image region and image errors to a diagnosis, and make the images of its report.

    Recordings that are tables of latents have no images; the content is then empty.
    """
    assert inputs.recordings is not None, "the sim is no fitted run"
    renderer = _BlockRenderer(inputs.recordings, inputs, found)
    seen = renderer.seen()
    if seen is None:
        return found, ReportContent()
    excess_error = compute_excess_error(seen.real, seen.sim, seen.encoded)
    place, body = renderer.place()
    where = found.diagnosis.where
    if where is not None:
        points = None if body is None else body.at(seen.q)
        where = replace(where, image_region=describe_image_region(excess_error, place, points))
    checks = {**found.diagnosis.checks, "image": renderer.image_gap(seen)}
    diagnosis = replace(found.diagnosis, where=where, checks=checks)
    worst = int(np.argmax(np.mean((seen.sim - seen.real) ** 2, axis=(1, 2, 3))))
    content = ReportContent(
        image_error=ImageErrorMap(
            _to_bytes(seen.real[worst]), np.maximum(excess_error.map, 0.0), excess_error.parts
        ),
        image_force=None if place is None or body is None else renderer.force(seen, place, body),
        video=renderer.film(),
    )
    return replace(found, diagnosis=diagnosis), content


class _BlockRenderer:
    """Renders the held-out blocks of one diagnosed run."""

    def __init__(self, recordings: RecordingPair, inputs: "DiagnosisInputs", found: DiagnosisRun) -> None:
        self.recordings, self.inputs, self.found = recordings, inputs, found
        self.run = recordings.run
        self.period_s = float(found.diagnosis.checks["natural_period_s"])

    @cached_property
    def smoothed(self) -> Sequence[LatentForceEstimate]:
        """The real trajectories with the force that the sim lacks; none where that force is not finite."""
        where = self.found.diagnosis.where
        return () if where is None else where.smoothed

    def draw(self, q: np.ndarray) -> np.ndarray:
        """Render latents (T, d) as images (T, H, W, 3)."""
        return render_latents(self.run.autoencoder, self.run.chart, q)

    def seen(self) -> RenderedBlocks | None:
        """Render the held-out blocks; None where no block has images."""
        for recorded in self.recordings.real_recordings:
            if recorded.recording is None:
                continue
            blocks = [b for b in self.found.diagnosis.blocks if b.file == recorded.motion.source]
            if blocks:
                return self._seen(recorded, blocks, MAX_COMPARED_FRAMES)
        return None

    def _seen(self, recorded: RecordedTrajectory, blocks: Sequence[Block], most: int) -> RenderedBlocks:
        assert recorded.recording is not None
        time_s = np.concatenate([block.time_s for block in blocks])
        chosen = choose_evenly(len(time_s), most)
        at = find_nearest_frames(recorded.recording, time_s[chosen])
        q = {
            name: np.concatenate([getattr(block, name) for block in blocks])[chosen]
            for name in ("real", "sim", "augmented")
        }
        return RenderedBlocks(
            recorded,
            at,
            q["real"],
            read_frames(recorded.recording, at),
            self.draw(q["sim"]),
            self.draw(q["augmented"]),
            self.draw(q["real"]),
        )

    def image_gap(self, seen: RenderedBlocks) -> dict[str, Any]:
        """Root mean square image errors: of rendering alone, of the sim's forecast, and with the effects."""
        floor, before, after = (
            float(np.sqrt(np.mean(image_errors(one, seen.real))))
            for one in (seen.encoded, seen.sim, seen.augmented)
        )
        errors: dict[str, Any] = {"floor": floor, "before": before, "after": after}
        errors["closure"] = (before - after) / (before - floor) if before > 1.02 * floor else None
        shares = self._stages(seen, before)
        return errors if shares is None else errors | {"stages": shares}

    def _stages(self, seen: RenderedBlocks, rollout: float) -> dict[str, float] | None:
        """Share of the rollouts' squared error that each stage adds; see `compute_stage_shares`."""
        estimate = next((s for s in self.smoothed if s.motion.source == seen.recorded.motion.source), None)
        if estimate is None or seen.recorded.recording is None:
            return None
        recording, motion = seen.recorded.recording, estimate.motion
        begins = {start for start, _ in motion.segments}
        inside = np.array([i for i in choose_evenly(motion.n, MAX_COMPARED_FRAMES) if i not in begins])
        real = read_frames(recording, find_nearest_frames(recording, motion.time_s[inside]))
        before = np.stack([inside - 1, inside], axis=1)
        step = forecast_positions(
            self.inputs.sim.model,
            estimate.q[inside - 1],
            estimate.v[inside - 1],
            motion.time_s[before],
            motion.u[before],
            finest_s=self.period_s / 50.0,
        )[:, 1]
        errors = [
            float(np.mean(image_errors(self.draw(q), real)))
            for q in (motion.q[inside], estimate.q[inside], step)
        ]
        shares = compute_stage_shares(
            decoded=errors[0], smoothed=errors[1], one_step=errors[2], rollout=max(rollout**2, *errors)
        )
        return {name: share for name, (share, _) in shares.items()}

    def place(self) -> tuple[ForceLocalization | None, BodyPoints | None]:
        """Find the point at which a force explains the residual best; None where there is no residual."""
        if not self.smoothed:
            return None, None
        estimate = max(self.smoothed, key=lambda s: float(np.mean(s.residual**2)))
        if not estimate.active.any():
            return None, None
        body = find_body_points(self.run.autoencoder, self.run.chart)
        at = choose_evenly(estimate.motion.n, MAX_FORCE_SAMPLES)
        force = estimate.residual[at]
        # a force too small to be detected is not known to be zero
        least = MIN_FORCE_SHARE * float(np.sqrt(np.mean(force**2)))
        covariance = estimate.covariance[at] + least**2 * np.eye(force.shape[1])
        effect_of_force = body.jacobian / compute_rest_inertia(self.inputs.sim.model)[None, :, None]
        reach = np.broadcast_to(effect_of_force, (len(at), *effect_of_force.shape))
        return localize_force(force, covariance, reach, estimate.v[at]), body

    def force(self, seen: RenderedBlocks, place: ForceLocalization, body: BodyPoints) -> ImageForceMap:
        """The force at the instant of its maximum, on the frame of that instant."""
        estimate = max(self.smoothed, key=lambda s: float(np.mean(s.residual**2)))
        times = estimate.motion.time_s[choose_evenly(estimate.motion.n, MAX_FORCE_SAMPLES)]
        main = 0 if place.force is None else int(np.argmax(np.linalg.norm(place.force, axis=1)))
        recorded = next(
            (s for s in self.recordings.real_recordings if s.motion.source == estimate.motion.source),
            seen.recorded,
        )
        recording = recorded.recording or seen.recorded.recording
        assert recording is not None
        at = find_nearest_frames(recording, times[[main]])
        q = estimate.q[choose_evenly(estimate.motion.n, MAX_FORCE_SAMPLES)][[main]]
        forces = np.zeros((len(place.explained), 2))
        for number, force in zip(place.near, place.forces, strict=True):
            forces[number] = force[main]
        return ImageForceMap(
            _to_bytes(read_frames(recording, at)[0]),
            body.at(q)[0],
            place.explained,
            forces,
            place.near,
            place.localisable,
        )

    def film(self) -> VideoComparison | None:
        """A video of consecutive blocks around the one that the sim forecasts worst."""
        for recorded in self.recordings.real_recordings:
            blocks = [b for b in self.found.diagnosis.blocks if b.file == recorded.motion.source]
            if recorded.recording is None or not blocks:
                continue
            worst = int(np.argmax([np.mean((b.sim - b.real) ** 2) for b in blocks]))
            first = max(0, min(worst - VIDEO_BLOCKS // 2, len(blocks) - VIDEO_BLOCKS))
            seen = self._seen(recorded, blocks[first : first + VIDEO_BLOCKS], MAX_VIDEO_FRAMES)
            frames = sum(len(b.time_s) for b in blocks[first : first + VIDEO_BLOCKS])
            step_s = recorded.motion.dt_s * max(1.0, frames / len(seen.at))
            slowed = max(1.0, MIN_PERIOD_S / self.period_s)
            recordings = (_to_bytes(seen.real), _to_bytes(seen.sim), _to_bytes(seen.augmented))
            return VideoComparison(*recordings, frames_per_s=1.0 / (step_s * slowed), slowed=slowed)
        return None


def _to_bytes(picture: np.ndarray) -> np.ndarray:
    return np.round(255.0 * np.clip(picture, 0.0, 1.0)).astype(np.uint8)
