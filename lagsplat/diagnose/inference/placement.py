"""Every effect at every place where it may act, and when and how fast external forces may act."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np
from jaxtyping import Float64
from scipy.signal import find_peaks

from lagsplat.diagnose.core.config import PROBLEM
from lagsplat.diagnose.effects.base import Direction, DisturbanceHints, PlacedEffect, PlaceFinder
from lagsplat.diagnose.effects.parameters import Scales
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.diagnose.estimation.dataset import compute_clock_shifts
from lagsplat.diagnose.estimation.rollout import RolloutModel
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.residual.change_points import find_events
from lagsplat.diagnose.residual.latent_force import LatentForceEstimate, estimate_latent_force
from lagsplat.io.trajectory.trajectory import Trajectory


def place_effects(
    rollout_model: RolloutModel,
    hints: Sequence[DisturbanceHints],
    *,
    q_names: Sequence[str],
    u_names: Sequence[str],
    without: Sequence[str],
) -> list[PlacedEffect]:
    """Every effect of the catalogue at every place where something moves."""
    model, record = rollout_model.model, rollout_model.dataset
    eye, whole = np.eye(model.d), measure_largest_motion_scales(rollout_model)
    inputs = []
    for j, u in enumerate(record.u.T):
        if np.ptp(u) > 0.0:
            scales = replace(whole, input=_rms(u), input_reach=float(np.abs(u).max()))
            inputs.append((j, u_names[j], scales))
    joints = combinations(range(model.d if model.d <= PROBLEM.max_joint_coordinates else 0), 2)
    # the longest clips show best where a memory began
    by_length = np.argsort(np.diff(record.clips, axis=1)[:, 0], kind="stable")[::-1]
    finder = PlaceFinder(
        coordinates=tuple(Direction.of(name, eye[i], model) for i, name in enumerate(q_names)),
        pairs=tuple(Direction.of(f"{q_names[j]} - {q_names[i]}", eye[j] - eye[i], model) for i, j in joints),
        hints=tuple(hints),
        inputs=tuple(inputs),
        measure=partial(measure_motion_scales, rollout_model),
        whole=whole,
        longest_clips=tuple(sorted(by_length[: PROBLEM.free_memory_clips].tolist())),
        constant_inertia=len(model.mass) == 1,
    )
    effects = (effect for effect in catalogue().values() if effect.name not in without)
    placed = [place for effect in effects for place in finder.find(effect)]
    return [place for place in placed if place.scales.reach > 0.0]


def _rms(x: Float64[np.ndarray, " N"]) -> float:
    return float(np.sqrt(np.mean(x * x)))


def measure_motion_scales(rollout_model: RolloutModel, place: Direction, variant: str = "") -> Scales:
    """Sizes of the recorded motion along a direction."""
    model, record, p = rollout_model.model, rollout_model.dataset, place.covector
    s, v = (rollout_model.smooth - model.rest) @ p, record.v @ p
    reach = {"upper": s.max(), "lower": -s.min()}.get(variant, np.abs(s).max())
    size = _rms(s)
    return Scales(
        coordinate=size,
        velocity=max(_rms(v), 1e-6 * size),
        reach=float(reach) if reach > 0.3 * size else 0.0,
        stiffness=float(p @ model.stiffness @ p) / float(p @ model.inertia @ p),
        frame_s=record.dt_s,
        duration_s=float(max(record.time[stop - 1] for _, stop in record.clips)),
    )


def measure_largest_motion_scales(rollout_model: RolloutModel) -> Scales:
    """Sizes of the coordinate that moves most, by its kinetic energy."""
    model = rollout_model.model
    energy = np.diag(model.inertia) * np.mean(rollout_model.dataset.v**2, axis=0)
    largest = Direction.of(None, np.eye(model.d)[int(np.argmax(energy))], model)
    return measure_motion_scales(rollout_model, largest)


def extract_hints(
    smoothed: Sequence[LatentForceEstimate], *, period_s: float
) -> tuple[DisturbanceHints, ...]:
    """Events of the residual force on the joint clock; by coordinate, spectral lines of the longest file."""
    shifts = compute_clock_shifts([estimate.motion for estimate in smoothed])
    pushes = tuple(
        (event.start_s - shifts[event.motion], event.end_s - shifts[event.motion])
        for event in find_events(smoothed, period_s=period_s)
    )
    longest = max(smoothed, key=lambda estimate: estimate.motion.n)
    return tuple(DisturbanceHints(pushes, find_spectral_lines(longest, i)) for i in range(longest.motion.d))


def find_hints(
    model: MechanicalModel, motions: Sequence[Trajectory], *, period_s: float, hold: str
) -> tuple[DisturbanceHints, ...]:
    """Hints from the force that the sim lacks; none where the sim diverges along the motions."""
    try:
        smoothed = estimate_latent_force(model, motions, period_s=period_s, hold=hold)
    except np.linalg.LinAlgError:
        return (DisturbanceHints((), ()),) * model.d
    return extract_hints(smoothed, period_s=period_s)


def find_spectral_lines(estimate: LatentForceEstimate, coordinate: int) -> tuple[float, ...]:
    """The frequencies [Hz] of the highest peaks in the spectrum of the residual."""
    motion = estimate.motion
    time = np.arange(motion.time_s[0], motion.time_s[-1], motion.dt_s)
    x: Float64[np.ndarray, " n"] = np.interp(time, motion.time_s, estimate.residual[:, coordinate])
    size = 4 * len(x)
    power = np.abs(np.fft.rfft((x - x.mean()) * np.hanning(len(x)), size))
    frequency = np.fft.rfftfreq(size, motion.dt_s)
    power[frequency > PROBLEM.max_line_frequency / motion.dt_s] = 0.0
    peaks, found = find_peaks(power[2:], height=0.0)
    best = peaks[np.argsort(found["peak_heights"])[::-1][: PROBLEM.max_lines]] + 2
    return tuple(float(frequency[i]) for i in best)
