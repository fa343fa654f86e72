"""What the pictures of a diagnosed run show: how well they are read, where they are wrong, and a film.

What the report of any diagnosis shows beside its verdict: the ladder, and how much the recording tells.
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
import contextlib
from typing import TYPE_CHECKING

from lagsplat.diagnose.inference.identifiability import compute_separability
from lagsplat.diagnose.inference.profile_likelihood import compute_profiles
from lagsplat.diagnose.residual.components import compute_residual_correlations
from lagsplat.diagnose.residual.error_budget import ErrorStage, measure_error_stages
from lagsplat.diagnose.residual.latent_force import estimate_latent_force
from lagsplat.io.trajectory.trajectory import Trajectory, leading_samples

if TYPE_CHECKING:
    from lagsplat.pipelines.diagnosis_inputs import DiagnosisInputs


COMPARED = 240  # frames of held-out blocks that are drawn
FILMED = 8  # blocks in a row that the film shows
FILMED_FRAMES = 300
SLOWEST_S = 1.0  # a period takes this long on the film at least
PLACED = 400  # instants at which the force is placed
SEEN = 0.1  # of the largest force, below which none would be noticed


@dataclass(frozen=True)
class RenderedBlocks:
    """Frames of held-out blocks (T, H, W, 3): measured, and drawn of the sim's forecast, of the one with
    effects, and of the latents as encoded, which are ``q`` (T, d). ``at`` (T,) are their numbers."""

    recorded: RecordedTrajectory
    at: np.ndarray
    q: np.ndarray
    real: np.ndarray
    sim: np.ndarray
    augmented: np.ndarray
    encoded: np.ndarray


def build_image_content(inputs: "DiagnosisInputs", found: DiagnosisRun) -> tuple[DiagnosisRun, ReportContent]:
    """The diagnosis with its region of the picture and its errors in pictures, and the figures of both.

    Of tables of latents there are no pictures, and none are shown.
    """
    assert inputs.recordings is not None, "the sim is no fitted run"
    drawer = _BlockRenderer(inputs.recordings, inputs, found)
    seen = drawer.seen()
    if seen is None:
        return found, ReportContent()
    excess = compute_excess_error(seen.real, seen.sim, seen.encoded)
    place, body = drawer.place()
    where = replace(
        found.diagnosis.where,
        image_region=describe_image_region(excess, place, None if body is None else body.at(seen.q)),
    )
    checks = {**found.diagnosis.checks, "image": drawer.image_gap(seen)}
    diagnosis = replace(found.diagnosis, where=where, checks=checks)
    worst = int(np.argmax(np.mean((seen.sim - seen.real) ** 2, axis=(1, 2, 3))))
    exhibits = ReportContent(
        picture=ImageErrorMap(_to_bytes(seen.real[worst]), np.maximum(excess.map, 0.0), excess.parts),
        force=None if place is None or body is None else drawer.force(seen, place, body),
        film=drawer.film(),
    )
    return replace(found, diagnosis=diagnosis), exhibits


class _BlockRenderer:
    """Draws one diagnosed run."""

    def __init__(self, recordings: RecordingPair, inputs: "DiagnosisInputs", found: DiagnosisRun) -> None:
        self.recordings, self.inputs, self.found = recordings, inputs, found
        self.run = recordings.run
        self.period_s = float(found.diagnosis.checks["natural_period_s"])

    @cached_property
    def smoothed(self) -> Sequence[LatentForceEstimate]:
        """The real motions with the force the sim lacks."""
        return self.found.diagnosis.where.smoothed

    def draw(self, q: np.ndarray) -> np.ndarray:
        """Pictures of latents."""
        return render_latents(self.run.autoencoder, self.run.chart, q)

    def seen(self) -> RenderedBlocks | None:
        """Held-out blocks, drawn; None where no block has pictures."""
        for recorded in self.recordings.real_recordings:
            if recorded.recording is None:
                continue
            blocks = [b for b in self.found.diagnosis.blocks if b.file == recorded.motion.source]
            if blocks:
                return self._seen(recorded, blocks, COMPARED)
        return None

    def _seen(self, recorded: RecordedTrajectory, blocks: Sequence[Block], most: int) -> RenderedBlocks:
        assert recorded.recording is not None
        time_s = np.concatenate([block.time_s for block in blocks])
        chosen = choose_evenly(len(time_s), most)
        at = find_nearest_frames(recorded.recording, time_s[chosen])
        q = {name: np.concatenate([getattr(b, name) for b in blocks])[chosen]
             for name in ("real", "sim", "augmented")}  # fmt: skip
        return RenderedBlocks(
            recorded, at, q["real"], read_frames(recorded.recording, at),
            self.draw(q["sim"]), self.draw(q["augmented"]), self.draw(q["real"]),
        )  # fmt: skip

    def image_gap(self, seen: RenderedBlocks) -> dict[str, Any]:
        """Root mean squared errors of the pictures: what drawing leaves, the sim's, and with the effects."""
        floor, before, after = (
            float(np.sqrt(np.mean(image_errors(one, seen.real))))
            for one in (seen.encoded, seen.sim, seen.augmented)
        )
        told: dict[str, Any] = {"floor": floor, "before": before, "after": after}
        told["closure"] = (before - after) / (before - floor) if before > 1.02 * floor else None
        shares = self._stages(seen, before)
        return told if shares is None else told | {"stages": shares}

    def _stages(self, seen: RenderedBlocks, rollout: float) -> dict[str, float] | None:
        """Share of the rollouts' squared error that each stage adds; see `compute_stage_shares`."""
        one = next((s for s in self.smoothed if s.motion.source == seen.recorded.motion.source), None)
        if one is None or seen.recorded.recording is None:
            return None
        recording, motion = seen.recorded.recording, one.motion
        begins = {start for start, _ in motion.segments}
        inside = np.array([i for i in choose_evenly(motion.n, COMPARED) if i not in begins])
        real = read_frames(recording, find_nearest_frames(recording, motion.time_s[inside]))
        before = np.stack([inside - 1, inside], axis=1)
        step = forecast_positions(
            self.inputs.sim.model,
            one.q[inside - 1], one.v[inside - 1], motion.time_s[before], motion.u[before],
            finest_s=self.period_s / 50.0,
        )[:, 1]  # fmt: skip
        errors = [
            float(np.mean(image_errors(self.draw(q), real))) for q in (motion.q[inside], one.q[inside], step)
        ]
        shares = compute_stage_shares(
            decoded=errors[0], smoothed=errors[1], one_step=errors[2], rollout=max(rollout**2, *errors)
        )
        return {name: share for name, (share, _) in shares.items()}

    def place(self) -> tuple[ForceLocalization | None, BodyPoints | None]:
        """The point on which a force explains the residual best; None where the sim lacks none."""
        one = max(self.smoothed, key=lambda s: float(np.mean(s.residual**2)))
        if not one.active.any():
            return None, None
        body = find_body_points(self.run.autoencoder, self.run.chart)
        at = choose_evenly(one.motion.n, PLACED)
        force = one.residual[at]
        # A force too small to be noticed is not known to be none.
        least = SEEN * float(np.sqrt(np.mean(force**2)))
        covariance = one.covariance[at] + least**2 * np.eye(force.shape[1])
        felt = body.jacobian / compute_rest_inertia(self.inputs.sim.model)[None, :, None]
        reach = np.broadcast_to(felt, (len(at), *felt.shape))
        return localize_force(force, covariance, reach, one.v[at]), body

    def force(self, seen: RenderedBlocks, place: ForceLocalization, body: BodyPoints) -> ImageForceMap:
        """The force where it is largest, on the frame of that instant."""
        one = max(self.smoothed, key=lambda s: float(np.mean(s.residual**2)))
        times = one.motion.time_s[choose_evenly(one.motion.n, PLACED)]
        main = 0 if place.force is None else int(np.argmax(np.linalg.norm(place.force, axis=1)))
        recorded = next(
            (s for s in self.recordings.real_recordings if s.motion.source == one.motion.source),
            seen.recorded,
        )
        recording = recorded.recording or seen.recorded.recording
        assert recording is not None
        at = find_nearest_frames(recording, times[[main]])
        q = one.q[choose_evenly(one.motion.n, PLACED)][[main]]
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
        """Blocks in a row around the one that the sim forecasts worst."""
        for recorded in self.recordings.real_recordings:
            blocks = [b for b in self.found.diagnosis.blocks if b.file == recorded.motion.source]
            if recorded.recording is None or not blocks:
                continue
            worst = int(np.argmax([np.mean((b.sim - b.real) ** 2) for b in blocks]))
            first = max(0, min(worst - FILMED // 2, len(blocks) - FILMED))
            seen = self._seen(recorded, blocks[first : first + FILMED], FILMED_FRAMES)
            frames = sum(len(b.time_s) for b in blocks[first : first + FILMED])
            step_s = recorded.motion.dt_s * max(1.0, frames / len(seen.at))
            slowed = max(1.0, SLOWEST_S / self.period_s)
            recordings = (_to_bytes(seen.real), _to_bytes(seen.sim), _to_bytes(seen.augmented))
            return VideoComparison(*recordings, frames_per_s=1.0 / (step_s * slowed), slowed=slowed)
        return None


def _to_bytes(picture: np.ndarray) -> np.ndarray:
    return np.round(255.0 * np.clip(picture, 0.0, 1.0)).astype(np.uint8)


CLIMBED = 40  # natural periods of the sim's own motions by which the floors of the ladder are told


def build_report_content(inputs: "DiagnosisInputs", found: DiagnosisRun) -> ReportContent:
    """The ladder, what the residual goes with, what is told apart, how sharply numbers are known."""
    noise_inflation, real = found.ranking.noise_inflation, inputs.real[0]
    where = found.diagnosis.where
    return ReportContent(
        rungs=compute_error_stages(inputs, found),
        fingerprint=where
        and compute_residual_correlations(where.smoothed, q_names=real.q_names, u_names=real.u_names),
        separability=compute_separability(
            found.problem, found.ranking.found, noise_inflation=noise_inflation
        ),
        profiles=tuple(compute_profiles(found.problem, found.chosen, noise_inflation=noise_inflation)),
    )


def compute_error_stages(inputs: "DiagnosisInputs", found: DiagnosisRun) -> tuple[ErrorStage, ...]:
    """The ladder; floors are those of the sim's own motions, of its training part if it is a fitted run.

    None where the residual could not be worked out.
    """
    if found.diagnosis.where is None:
        return ()
    checked, period_s = inputs.checked.sim, float(found.diagnosis.checks["natural_period_s"])
    nominal = None
    if checked is not None:
        part = _first_part(checked.motions, CLIMBED * period_s)
        hold = "zoh" if found.problem.rollout_model.held else "linear"
        with contextlib.suppress(np.linalg.LinAlgError):  # a sim that cannot follow even its own motions
            nominal = estimate_latent_force(inputs.sim.model, part, period_s=period_s, hold=hold)
    image_quality = None if inputs.recordings is None else inputs.recordings.image_quality
    return measure_error_stages(
        inputs.sim.model,
        found.diagnosis.where.smoothed,
        nominal,
        horizon_s=period_s,
        image_errors=None
        if image_quality is None
        else (image_quality.error_real, image_quality.error_nominal),
        block=10,
    )


def _first_part(motions: Sequence[Trajectory], length_s: float) -> list[Trajectory]:
    """The first of all motions, as much as lasts ``length_s`` together."""
    kept: list[Trajectory] = []
    for motion in motions:
        if length_s > 0.0:
            kept.append(leading_samples(motion, length_s))
            length_s -= kept[-1].duration_s
    return kept
