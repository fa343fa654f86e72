"""Where the gap between a sim and a recording lies: level, coordinate, time, frequency, state, component."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lagsplat.diagnose.core.config import LOCALIZATION
from lagsplat.diagnose.mechanics.model import Mechanics, compute_rest_period_s
from lagsplat.diagnose.residual.change_points import ResidualEvent, find_events
from lagsplat.diagnose.residual.components import (
    ResidualComponents,
    compute_components,
    compute_explained_share,
)
from lagsplat.diagnose.residual.features import FEATURE_GROUPS, ResidualFeatures, compute_features
from lagsplat.diagnose.residual.latent_force import (
    LatentForceEstimate,
    compute_coordinate_shares,
    compute_relative_squares,
    estimate_latent_force,
)
from lagsplat.diagnose.residual.measurement_model import compute_distortion_share, measure_speed_noise
from lagsplat.diagnose.residual.spectrum import ResidualSpectrum, compute_spectrum
from lagsplat.diagnose.residual.state_maps import StateMap, StateRegion, find_state_regions
from lagsplat.io.trajectory.trajectory import Trajectory


@dataclass(frozen=True)
class ResidualLocation:
    """Where a gap lies. Shares are of the square of the residual acceleration over each coordinate's swing.

    ``level`` "perception", "chart", "actuation" or "dynamics"; ``coordinates`` share by name; ``time_s``
    (file, start, end, share); ``frequency_hz`` (low, high, share); ``state_region`` by coordinate, the boxes
    in which the residual keeps its sign; ``image_region`` as of `image_region`, None without pictures;
    ``compute_components`` share by kind of term, with "unexplained"; ``memory_index`` in [0, 1]; ``evidence``
    nats by which each coordinate's residual force makes the recording more likely; ``size`` rms of the
    residual over the swing's acceleration: of a hundredth or less, all else says little. For figures:
    ``smoothed`` of every motion, ``compute_spectrum`` (None for short clips), ``maps`` of state.
    """

    level: str
    coordinates: dict[str, float]
    time_s: tuple[tuple[str, float, float, float], ...]
    frequency_hz: tuple[tuple[float, float, float], ...]
    state_region: dict[str, Any]
    image_region: dict[str, Any] | None
    components: dict[str, float]
    memory_index: float
    evidence: dict[str, float]
    size: float
    smoothed: tuple[LatentForceEstimate, ...]
    spectrum: ResidualSpectrum | None
    maps: tuple[StateMap, ...]


def locate(
    mechanics: Mechanics,
    motions: Sequence[Trajectory],
    *,
    period_s: float | None = None,
    ar1: float = 0.0,
    hold: str = "linear",
    noise: np.ndarray | None = None,
    perception_suspect: bool = False,
    image_region: dict[str, Any] | None = None,
) -> ResidualLocation:
    """Where the force that ``mechanics`` lacks on ``motions`` lies.

    ``period_s`` is the natural period, by default the sim's slowest at rest; ``ar1``, ``hold`` and ``noise``
    as of `estimate_latent_force`. ``perception_suspect`` says that pictures are drawn or encoded worse than
    those the sim was learnt from, which makes perception the level whatever the forces say.

    Raises:
        ValueError: as of `estimate_latent_force`; or the sim has no natural period and none is given.
    """
    scale = np.std(np.concatenate([motion.q for motion in motions]), axis=0)
    period = compute_rest_period_s(mechanics, scale) if period_s is None else period_s
    smoothed = estimate_latent_force(mechanics, motions, period_s=period, ar1=ar1, hold=hold, noise=noise)
    share = compute_coordinate_shares(smoothed)
    seen = compute_spectrum(smoothed, period_s=period)
    found = compute_features(
        mechanics, smoothed, period_s=period, lines_hz=_find_undriven_lines(seen, motions[0].n_u)
    )
    happened = find_events(smoothed, period_s=period)
    parts = _assign_brief_events(compute_components(found, share), happened, smoothed)
    boxes, maps = find_state_regions(smoothed, period_s=period)
    names = motions[0].q_names
    return ResidualLocation(
        level=_decide_level(mechanics, smoothed, found, share, parts, period, perception_suspect),
        coordinates=dict(zip(names, share.tolist(), strict=True)),
        time_s=tuple((motions[one.motion].source, one.start_s, one.end_s, one.share) for one in happened),
        frequency_hz=() if seen is None else seen.bands,
        state_region=_describe_regions(boxes, names),
        image_region=image_region,
        components=parts.shares,
        memory_index=parts.memory_index,
        evidence=dict(zip(names, smoothed[0].evidence.tolist(), strict=True)),
        size=float(np.sqrt(np.mean(np.concatenate(compute_relative_squares(smoothed))))),
        smoothed=tuple(smoothed),
        spectrum=seen,
        maps=tuple(maps),
    )


def _find_undriven_lines(seen: ResidualSpectrum | None, n_u: int) -> list[float]:
    """Frequencies of lines that no input drives."""
    if seen is None:
        return []
    free = []
    for line in seen.lines:
        at = int(np.argmin(np.abs(seen.frequency_hz - line.frequency_hz)))
        driven = np.max(seen.coherence[at, line.coordinate, :n_u], initial=0.0)
        if driven < seen.significant:
            free.append(line.frequency_hz)
    return free[:3]


def _assign_brief_events(
    parts: ResidualComponents, happened: Sequence[ResidualEvent], smoothed: Sequence[LatentForceEstimate]
) -> ResidualComponents:
    """What nothing explains and acts briefly came from outside, since left-out blocks cannot foretell it.

    Unless it acts where the motion goes at no other time: then position may be its cause.
    """
    lasted = sum(one.end_s - one.start_s for one in happened)
    held = sum(one.share for one in happened)
    moved = parts.shares["unexplained"] + parts.shares["memory"]
    brief = lasted < LOCALIZATION.max_event_time_share * sum(one.motion.duration_s for one in smoothed)
    if moved < 0.5 or held < LOCALIZATION.min_event_energy_share or not brief:
        return parts
    cause = "conservative" if _acts_beyond_usual_positions(happened, smoothed) else "exogenous"
    left = {"memory": 0.0, "unexplained": (1.0 - held) * moved, cause: parts.shares[cause] + held * moved}
    return ResidualComponents(parts.shares | left, parts.memory_index)


def _acts_beyond_usual_positions(
    happened: Sequence[ResidualEvent], smoothed: Sequence[LatentForceEstimate]
) -> bool:
    """Whether most of the events' residual acts beyond the positions of all other times."""
    inside = [np.zeros(one.motion.n, dtype=bool) for one in smoothed]
    for event in happened:
        time_s = smoothed[event.motion].motion.time_s
        inside[event.motion] |= (time_s >= event.start_s) & (time_s <= event.end_s)
    within, square = np.concatenate(inside), np.concatenate(compute_relative_squares(smoothed))
    main = int(np.argmax(square.sum(axis=0)))
    q = np.concatenate([one.q[:, main] for one in smoothed])
    low, high = np.quantile(q[~within], [0.005, 0.995])
    beyond = within & ((q < low) | (q > high))
    return bool(square[beyond, main].sum() > 0.5 * square[within, main].sum())


def _describe_regions(found: Sequence[StateRegion], names: Sequence[str]) -> dict[str, Any]:
    return {
        name: [
            {
                "position": list(one.position),
                "velocity": None if one.velocity is None else list(one.velocity),
                "mean": one.mean,
                "share": one.share,
                "p": one.p,
            }
            for one in found
            if names[one.coordinate] == name
        ]
        for name in names
        if any(names[one.coordinate] == name for one in found)
    }


def _decide_level(
    mechanics: Mechanics,
    smoothed: Sequence[LatentForceEstimate],
    found: ResidualFeatures,
    share: np.ndarray,
    parts: ResidualComponents,
    period_s: float,
    perception_suspect: bool,
) -> str:
    uncertain = measure_speed_noise(smoothed, period_s=period_s)
    if perception_suspect or (
        uncertain.p < LOCALIZATION.max_speed_noise_p and uncertain.share > LOCALIZATION.min_speed_noise_share
    ):
        return "perception"
    if share.max() > 0.0:
        main = int(np.argmax(share))
        distorted = compute_distortion_share(found, mechanics, smoothed, main)
        forces = max(
            compute_explained_share(found, main, found.groups[main][name]) for name in FEATURE_GROUPS
        )
        if distorted > LOCALIZATION.min_chart_share and distorted > forces + LOCALIZATION.min_chart_lead:
            return "chart"
    explained_share = 1.0 - parts.shares["unexplained"]
    if (
        parts.shares["actuation"]
        > max(LOCALIZATION.min_actuation_share * explained_share, LOCALIZATION.min_actuation_residual_share)
        and parts.largest == "actuation"
    ):
        return "actuation"
    return "dynamics"
