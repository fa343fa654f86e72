"""Every effect at every place where it may act, and where in time and frequency to look for external
forces."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np
from jaxtyping import Float64
from scipy.signal import find_peaks

from lagsplat.diagnose.core.config import PLACEMENT
from lagsplat.diagnose.effects.base import (
    Direction,
    DisturbanceHints,
    PlacedEffect,
    PlacementProblem,
    make_direction,
)
from lagsplat.diagnose.effects.parameters import Scales
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.diagnose.estimation.dataset import compute_clock_shifts
from lagsplat.diagnose.estimation.rollout import RolloutModel
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.residual.change_points import find_events
from lagsplat.diagnose.residual.latent_force import LatentForceEstimate, estimate_latent_force
from lagsplat.io.trajectory.trajectory import Trajectory


def list_coordinate_directions(rollout_model: RolloutModel, names: Sequence[str]) -> list[Direction]:
    """Directions along each coordinate."""
    eye = np.eye(rollout_model.model.d)
    return [make_direction(name, eye[i], rollout_model.model) for i, name in enumerate(names)]


def list_joint_directions(rollout_model: RolloutModel, names: Sequence[str]) -> list[Direction]:
    """Directions along the difference of each two coordinates, where these are few."""
    model, eye = rollout_model.model, np.eye(rollout_model.model.d)
    pairs = combinations(range(model.d if model.d <= PLACEMENT.max_joint_coordinates else 0), 2)
    return [make_direction(f"{names[j]} - {names[i]}", eye[j] - eye[i], model) for i, j in pairs]


def place_effects(
    rollout_model: RolloutModel,
    hints: Sequence[DisturbanceHints],
    *,
    q_names: Sequence[str],
    u_names: Sequence[str],
    without: Sequence[str],
) -> list[PlacedEffect]:
    """Every effect of the catalogue at every place where something moves."""
    problem = make_placement_problem(rollout_model, hints, q_names=q_names, u_names=u_names)
    effects = (effect for effect in catalogue().values() if effect.name not in without)
    placed = [place for effect in effects for place in effect.find_places(problem)]
    return [place for place in placed if place.scales.reach > 0.0]


def make_placement_problem(
    rollout_model: RolloutModel,
    hints: Sequence[DisturbanceHints],
    *,
    q_names: Sequence[str],
    u_names: Sequence[str],
) -> PlacementProblem:
    """What effects need to know of the mechanism and its recording to be placed."""
    whole = measure_largest_motion_scales(rollout_model)
    return PlacementProblem(
        coordinates=tuple(list_coordinate_directions(rollout_model, q_names)),
        pairs=tuple(list_joint_directions(rollout_model, q_names)),
        hints=tuple(hints),
        inputs=tuple(
            (j, u_names[j], replace(whole, input=_rms(u), input_reach=float(np.abs(u).max())))
            for j, u in enumerate(rollout_model.dataset.u.T)
            if np.ptp(u) > 0.0
        ),
        measure=partial(measure_motion_scales, rollout_model),
        whole=whole,
        longest_clips=tuple(_longest_clips(rollout_model)),
        constant_inertia=len(rollout_model.model.mass) == 1,
    )


def _longest_clips(rollout_model: RolloutModel) -> list[int]:
    """The clips that show best where a memory began."""
    order = np.argsort(np.diff(rollout_model.dataset.clips, axis=1)[:, 0], kind="stable")[::-1]
    return sorted(order[: PLACEMENT.free_memory_clips].tolist())


def _rms(x: Float64[np.ndarray, " N"]) -> float:
    return float(np.sqrt(np.mean(x * x)))


def measure_motion_scales(rollout_model: RolloutModel, place: Direction, variant: str = "") -> Scales:
    """Sizes of the recorded motion along a direction."""
    s = (rollout_model.smooth - rollout_model.model.rest) @ place.covector
    v = rollout_model.dataset.v @ place.covector
    reach = {"upper": s.max(), "lower": -s.min()}.get(variant, np.abs(s).max())
    size = float(np.sqrt(np.mean(s * s)))
    return Scales(
        coordinate=size,
        velocity=max(float(np.sqrt(np.mean(v * v))), 1e-6 * size),
        reach=float(reach) if reach > 0.3 * size else 0.0,
        stiffness=_stiffness(rollout_model, place),
        frame_s=rollout_model.dataset.dt_s,
        duration_s=float(max(rollout_model.dataset.time[b - 1] for _, b in rollout_model.dataset.clips)),
    )


def _stiffness(rollout_model: RolloutModel, place: Direction) -> float:
    p = place.covector
    return float(p @ rollout_model.model.stiffness @ p) / float(p @ rollout_model.model.inertia @ p)


def measure_largest_motion_scales(rollout_model: RolloutModel) -> Scales:
    """Sizes of the coordinate that moves most, by its kinetic energy."""
    energy = np.diag(rollout_model.model.inertia) * np.mean(rollout_model.dataset.v**2, axis=0)
    i = int(np.argmax(energy))
    return measure_motion_scales(
        rollout_model, make_direction(None, np.eye(rollout_model.model.d)[i], rollout_model.model)
    )


def extract_hints(
    smoothed: Sequence[LatentForceEstimate], *, period_s: float
) -> tuple[DisturbanceHints, ...]:
    """Events of the residual force on the joint clock, and spectral lines of the longest file by
    coordinate."""
    shifts = compute_clock_shifts([one.motion for one in smoothed])
    pushes = tuple(
        (one.start_s - shifts[one.motion], one.end_s - shifts[one.motion])
        for one in find_events(smoothed, period_s=period_s)
    )
    longest = max(smoothed, key=lambda one: one.motion.n)
    return tuple(DisturbanceHints(pushes, find_spectral_lines(longest, i)) for i in range(longest.motion.d))


def find_hints(
    model: MechanicalModel, motions: Sequence[Trajectory], *, period_s: float, hold: str
) -> tuple[DisturbanceHints, ...]:
    """Hints from the force that the sim lacks; none where the sim diverges along the motions."""
    try:
        return extract_hints(
            estimate_latent_force(model, motions, period_s=period_s, hold=hold), period_s=period_s
        )
    except np.linalg.LinAlgError:
        return (DisturbanceHints((), ()),) * model.d


def find_spectral_lines(one: LatentForceEstimate, coordinate: int) -> tuple[float, ...]:
    """The frequencies [Hz] of the highest peaks in the spectrum of the residual."""
    motion = one.motion
    time = np.arange(motion.time_s[0], motion.time_s[-1], motion.dt_s)
    x: Float64[np.ndarray, " n"] = np.interp(time, motion.time_s, one.residual[:, coordinate])
    size = 4 * len(x)
    power = np.abs(np.fft.rfft((x - x.mean()) * np.hanning(len(x)), size))
    frequency = np.fft.rfftfreq(size, motion.dt_s)
    power[frequency > PLACEMENT.max_line_frequency / motion.dt_s] = 0.0
    peaks, found = find_peaks(power[2:], height=0.0)
    best = peaks[np.argsort(found["peak_heights"])[::-1][: PLACEMENT.max_lines]] + 2
    return tuple(float(frequency[i]) for i in best)
