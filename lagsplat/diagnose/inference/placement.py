"""Every effect at every place where it may act, and when and how fast external forces may act."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations
from types import MappingProxyType

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
    targets: Mapping[str, str] = MappingProxyType({}),
    computed: Sequence[str] = (),
) -> list[PlacedEffect]:
    """Every effect of the catalogue at every place where something moves.

    ``targets`` are the inputs that are position targets, each with its coordinate. ``computed`` inputs were
    not logged: no effect acts on them, and none is placed that `Effect.needs_all_forces`.

    Raises:
        ValueError: ``targets`` names an input or a coordinate that is not there.
    """
    for u_name, q_name in targets.items():
        if u_name not in u_names or q_name not in q_names:
            raise ValueError(
                f"diagnose.targets says that {u_name!r} is the target of {q_name!r}; the inputs are "
                f"{list(u_names)}, the coordinates {list(q_names)}"
            )
    servos = [(u_names.index(u_name), q_names.index(q_name)) for u_name, q_name in targets.items()]
    model, record = rollout_model.model, rollout_model.dataset
    eye, whole = np.eye(model.d), measure_largest_motion_scales(rollout_model)
    inputs = []
    for j, u in enumerate(record.u.T):
        if np.ptp(u) > 0.0 and u_names[j] not in computed:
            inputs.append((j, u_names[j], replace(whole, input=_rms(u))))
    # force by each input over the reference inertia, at rest [1/s^2]: of a target its controller's gain
    at_rest = np.repeat(model.rest[None], model.n_u, axis=0)
    gains = model.drive(at_rest, np.eye(model.n_u)) / np.diag(model.inertia)
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
        targets=tuple((j, i, float(gains[j, i])) for j, i in servos),
    )
    effects = [effect for effect in catalogue().values() if effect.name not in without]
    effects = [effect for effect in effects if not (computed and effect.needs_all_forces)]
    spared = tuple(j for j, name in enumerate(u_names) if name in computed)
    placed = [place for effect in effects for place in finder.find(effect) if place.scales.reach > 0.0]
    return [replace(place, spared=spared) for place in placed] if spared else placed


def _rms(x: Float64[np.ndarray, " N"]) -> float:
    return float(np.sqrt(np.mean(x * x)))


def measure_motion_scales(rollout_model: RolloutModel, place: Direction, variant: str = "") -> Scales:
    """Sizes of the recorded motion along a direction."""
    model, record, p = rollout_model.model, rollout_model.dataset, place.covector
    s, v = (record.smooth - model.rest) @ p, record.v @ p
    reach = {"upper": s.max(), "lower": -s.min()}.get(variant, np.abs(s).max())
    size = _rms(s)
    return Scales(
        coordinate=size,
        velocity=max(_rms(v), 1e-6 * size),
        reach=float(reach) if reach > 0.3 * size else 0.0,
        stiffness=float(p @ model.stiffness @ p) / float(p @ model.inertia @ p),
        drive=_rms(rollout_model.forces[1] @ p) / float(place.inertia),
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
    away = longest.q - np.median(longest.q, axis=0)
    shaking = find_common_line(longest)
    return tuple(
        DisturbanceHints(
            pushes,
            find_spectral_lines(longest, longest.residual[:, i]),
            find_spectral_lines(longest, longest.residual[:, i] * away[:, i]),
            shaking[i],
        )
        for i in range(longest.motion.d)
    )


def find_hints(
    model: MechanicalModel, motions: Sequence[Trajectory], *, period_s: float, hold: str
) -> tuple[DisturbanceHints, ...]:
    """Hints from the force that the sim lacks; none where the sim diverges along the motions."""
    try:
        smoothed = estimate_latent_force(model, motions, period_s=period_s, hold=hold)
    except np.linalg.LinAlgError:
        return (DisturbanceHints((), ()),) * model.d
    return extract_hints(smoothed, period_s=period_s)


def find_spectral_lines(
    estimate: LatentForceEstimate, signal: Float64[np.ndarray, " T"]
) -> tuple[float, ...]:
    """The frequencies [Hz] of the highest peaks in the spectrum of a signal along the motion."""
    frequency, spectrum = _compute_spectrum(estimate, signal[:, None])
    return tuple(float(frequency[i]) for i in _find_highest_peaks(np.abs(spectrum[:, 0])))


def find_common_line(estimate: LatentForceEstimate) -> list[tuple[float, float] | None]:
    """By coordinate, the frequency [Hz] of the highest line of all together, and its share in one phase.

    Each coordinate counts in units of its own rms acceleration. Nothing where there is no line.
    """
    frequency, spectrum = _compute_spectrum(estimate, estimate.residual)
    size = np.maximum(np.sqrt(np.mean(estimate.a**2, axis=0)), 1e-300)
    relative = spectrum / size
    peaks = _find_highest_peaks(np.sqrt(np.sum(np.abs(relative) ** 2, axis=1)))
    if not len(peaks):
        return [None] * estimate.motion.d
    line = spectrum[peaks[0]]
    # the phase in which the most of it lies
    turn = np.exp(-0.5j * np.angle(np.sum(relative[peaks[0]] ** 2)))
    return [(float(frequency[peaks[0]]), float(share)) for share in (line * turn).real]


def _compute_spectrum(
    estimate: LatentForceEstimate, signals: Float64[np.ndarray, "T k"]
) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [Hz] up to the highest line that is looked for, and the spectra of signals there."""
    motion = estimate.motion
    time = np.arange(motion.time_s[0], motion.time_s[-1], motion.dt_s)
    x = np.stack([np.interp(time, motion.time_s, column) for column in signals.T], axis=1)
    spectrum = np.fft.rfft((x - x.mean(axis=0)) * np.hanning(len(x))[:, None], 4 * len(x), axis=0)
    frequency = np.fft.rfftfreq(4 * len(x), motion.dt_s)
    kept = frequency <= PROBLEM.max_line_frequency / motion.dt_s
    return frequency[kept], spectrum[kept]


def _find_highest_peaks(size: Float64[np.ndarray, " n"]) -> np.ndarray:
    """Places of the highest peaks, the highest first; the lowest frequencies are a drift."""
    peaks, found = find_peaks(np.append(size[2:], 0.0), height=0.0)
    return peaks[np.argsort(found["peak_heights"])[::-1][: PROBLEM.max_lines]] + 2
