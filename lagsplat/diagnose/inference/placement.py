"""Every effect at every place where it may act on the mechanism at hand.

Where to look for disturbances: the spans and the lines of the force that a sim lacks.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from jaxtyping import Float64
from scipy.signal import find_peaks

from lagsplat.diagnose.core.config import PLACEMENT
from lagsplat.diagnose.effects.actuation.external_periodic_force import repeating
from lagsplat.diagnose.effects.actuation.external_push import N_PUSHES
from lagsplat.diagnose.effects.base import (
    Direction,
    DisturbanceHints,
    Effect,
    ForceEffect,
    InputEffect,
    PlacedEffect,
    make_direction,
    place_everywhere,
)
from lagsplat.diagnose.effects.dynamics.linear_stiffness import SPRING
from lagsplat.diagnose.effects.parameters import Scales
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.diagnose.estimation.dataset import compute_clock_shifts
from lagsplat.diagnose.estimation.rollout import RolloutModel
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.residual.change_points import find_events
from lagsplat.diagnose.residual.latent_force import LatentForceEstimate, estimate_latent_force
from lagsplat.io.trajectory.trajectory import Trajectory


def coordinate_directions(bench: RolloutModel, names: Sequence[str]) -> list[Direction]:
    """One along each coordinate."""
    eye = np.eye(bench.model.d)
    return [make_direction(name, eye[i], bench.model) for i, name in enumerate(names)]


def joint_directions(bench: RolloutModel, names: Sequence[str]) -> list[Direction]:
    """One along the difference of each two coordinates, if these are few."""
    model, eye = bench.model, np.eye(bench.model.d)
    pairs = combinations(range(model.d if model.d <= PLACEMENT.max_joint_coordinates else 0), 2)
    return [make_direction(f"{names[j]} - {names[i]}", eye[j] - eye[i], model) for i, j in pairs]


def place_effects(
    bench: RolloutModel,
    hints: Sequence[DisturbanceHints],
    *,
    q_names: Sequence[str],
    u_names: Sequence[str],
    without: Sequence[str],
) -> list[PlacedEffect]:
    """The catalogue at every place; ``extract_hints`` hold one entry a coordinate."""
    places, pairs = coordinate_directions(bench, q_names), joint_directions(bench, q_names)
    out: list[PlacedEffect] = []
    for effect in catalogue().values():
        if effect.name in without:
            continue
        for variant in effect.variants:
            if effect.along == "channels" or isinstance(effect, InputEffect):
                out += add_joint_placement(_place_on_inputs(effect, bench, u_names))
            elif effect.along == "whole":
                out.append(PlacedEffect(effect, largest_motion_scales(bench), variant))
            else:
                out += add_joint_placement(_place_along(effect, variant, bench, places, hints))
                if variant in effect.between:
                    out += _place_along(
                        effect, variant, bench, pairs, [DisturbanceHints((), ())] * len(pairs)
                    )
                everything = effect.along == "both" and variant != SPRING  # a spring is at one coordinate
                if everything and (bench.model.d > 1 or not isinstance(effect, ForceEffect)):
                    out.append(PlacedEffect(effect, largest_motion_scales(bench), variant))
    return [one for one in out if one.scales.reach > 0.0]


def add_joint_placement(places: Sequence[PlacedEffect]) -> list[PlacedEffect]:
    """The same, and where it may act at all of these places at once, that too."""
    moved = [one for one in places if one.scales.reach > 0.0]
    joint = len(moved) > 1 and moved[0].effect.together
    return [*places, *([place_everywhere(moved)] if joint else [])]


def _place_along(
    effect: Effect,
    variant: str,
    bench: RolloutModel,
    places: list[Direction],
    hints: Sequence[DisturbanceHints],
) -> list[PlacedEffect]:
    if variant == "weight" or (effect.name == "mass_change" and len(bench.model.mass) == 1 == bench.model.d):
        return []  # weight acts on the whole; a constant mass of one coordinate is the whole
    if isinstance(effect, ForceEffect) and effect.memory_kinds:
        effect = effect.begun(_longest_clips(bench))
    out = []
    for place, hint in zip(places, hints, strict=True):
        one = PlacedEffect(effect, motion_scales(bench, place, variant), variant, place)
        if effect.name == "external_push":
            one = replace(one, grid=_push_grid(hint, one.scales))
        if effect.name == "external_periodic_force":
            unit = one.scales.of("rate")
            lines = tuple((2.0 * np.pi * line / unit,) for line in hint.lines_hz)
            one = replace(one, effect=repeating(effect, one.scales), grid=lines)
        if one.grid is None or one.grid:
            out.append(one)
    return out


def _longest_clips(bench: RolloutModel) -> list[int]:
    """The clips that tell most of where a memory begins."""
    order = np.argsort(np.diff(bench.dataset.clips, axis=1)[:, 0], kind="stable")[::-1]
    return sorted(order[: PLACEMENT.free_memory_clips].tolist())


def _push_grid(hint: DisturbanceHints, size: Scales) -> tuple[tuple[float, ...], ...]:
    """The strongest pushes together, each as long as its event, or half of it."""
    unit, chosen = size.of("time"), hint.pushes[:N_PUSHES]
    if not chosen:
        return ()
    rows = []
    for share in (1.0, 0.5):
        middle = [0.5 * (start + end) / unit for start, end in chosen]
        lasts = [share * max(end - start, size.frame_s) / unit for start, end in chosen]
        # a push that is not needed stands where no window is
        absent = N_PUSHES - len(chosen)
        rows.append((*middle, *[-1e3] * absent, *lasts, *[1.0] * absent))
    return tuple(rows)


def _place_on_inputs(effect: Effect, bench: RolloutModel, u_names: Sequence[str]) -> list[PlacedEffect]:
    driven = [j for j in range(bench.dataset.u.shape[1]) if np.ptp(bench.dataset.u[:, j]) > 0.0]
    if not driven:
        return []
    if effect.along == "whole":
        return [PlacedEffect(effect, largest_motion_scales(bench))]
    out = []
    for j in driven:
        u = bench.dataset.u[:, j]
        base = largest_motion_scales(bench)
        size = replace(base, input=float(np.sqrt(np.mean(u * u))), input_reach=float(np.abs(u).max()))
        out.append(PlacedEffect(effect, size, channel=j, input_name=u_names[j]))
    return out


def motion_scales(bench: RolloutModel, place: Direction, variant: str = "") -> Scales:
    """Sizes of the recorded motion along a direction."""
    s = (bench.smooth - bench.model.rest) @ place.covector
    v = bench.dataset.v @ place.covector
    reach = {"upper": s.max(), "lower": -s.min()}.get(variant, np.abs(s).max())
    size = float(np.sqrt(np.mean(s * s)))
    return Scales(
        coordinate=size,
        velocity=max(float(np.sqrt(np.mean(v * v))), 1e-6 * size),
        reach=float(reach) if reach > 0.3 * size else 0.0,
        stiffness=_stiffness(bench, place),
        frame_s=bench.dataset.dt_s,
        duration_s=float(max(bench.dataset.time[b - 1] for _, b in bench.dataset.clips)),
    )


def _stiffness(bench: RolloutModel, place: Direction) -> float:
    p = place.covector
    return float(p @ bench.model.stiffness @ p) / float(p @ bench.model.inertia @ p)


def largest_motion_scales(bench: RolloutModel) -> Scales:
    """Sizes of the coordinate that moves most, by its kinetic energy."""
    energy = np.diag(bench.model.inertia) * np.mean(bench.dataset.v**2, axis=0)
    i = int(np.argmax(energy))
    return motion_scales(bench, make_direction(None, np.eye(bench.model.d)[i], bench.model))


def extract_hints(
    smoothed: Sequence[LatentForceEstimate], *, period_s: float
) -> tuple[DisturbanceHints, ...]:
    """The loudest spans, on the joint clock, and lines of the longest file, for each coordinate."""
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
    """Hints from the force that the sim lacks; none where it cannot follow the motions at all."""
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
