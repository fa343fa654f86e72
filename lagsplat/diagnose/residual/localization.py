"""Where the gap between a simulator and a recording lies.

`locate` says at which level, in which coordinate, when, at which frequencies, in which state and in which
kind of term.
"""

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
    """Where a gap lies; shares are of the squared residual over each coordinate's mean squared acceleration.

    ``level`` is "perception", "chart", "actuation" or "dynamics"; ``coordinates`` the share by name;
    ``time_s`` (file, start [s], end [s], share) of events; ``frequency_hz`` (low [Hz], high [Hz], share) of
    bands; ``state_region`` by coordinate, the boxes in which the residual keeps its sign; ``image_region`` as
    returned by `describe_image_region`, None without images; ``components`` the share by kind of term, with
    "unexplained"; ``memory_index`` in [0, 1]; ``evidence`` nats by which each coordinate's residual force
    makes the recording more likely; ``size`` rms of the residual over that of the acceleration: at a
    hundredth or less, the rest says little. For figures: ``smoothed`` of every motion, ``spectrum`` (None for
    short clips), ``maps`` over the state.
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
    """Locate the force that ``mechanics`` lacks on ``motions``.

    Args:
        mechanics: the simulator's equations of motion.
        motions: the recording.
        period_s: the natural period [s], by default the simulator's slowest at rest.
        ar1: correlation of the measurement noise from one sample to the next.
        hold: "linear" for inputs that are linear between samples, "zoh" for constant ones.
        noise: standard deviation (d,) of the measurement noise; by default it is estimated.
        perception_suspect: images are decoded or encoded worse than those the simulator was fitted to,
            which makes perception the level in any case.
        image_region: what is known of the place in the image, to be passed on.

    Raises:
        ValueError: as `estimate_latent_force`; or the simulator has no natural period and none is given.
    """
    scale = np.std(np.concatenate([motion.q for motion in motions]), axis=0)
    period = compute_rest_period_s(mechanics, scale) if period_s is None else period_s
    estimates = estimate_latent_force(mechanics, motions, period_s=period, ar1=ar1, hold=hold, noise=noise)
    coordinate_share = compute_coordinate_shares(estimates)
    spectrum = compute_spectrum(estimates, period_s=period)
    features = compute_features(
        mechanics, estimates, period_s=period, lines_hz=_find_undriven_lines(spectrum, motions[0].n_u)
    )
    events = find_events(estimates, period_s=period)
    components = _assign_brief_events(compute_components(features, coordinate_share), events, estimates)
    regions, maps = find_state_regions(estimates, period_s=period)
    names = motions[0].q_names
    return ResidualLocation(
        level=_decide_level(
            mechanics, estimates, features, coordinate_share, components, period, perception_suspect
        ),
        coordinates=dict(zip(names, coordinate_share.tolist(), strict=True)),
        time_s=tuple(
            (motions[event.motion].source, event.start_s, event.end_s, event.share) for event in events
        ),
        frequency_hz=() if spectrum is None else spectrum.bands,
        state_region=_describe_regions(regions, names),
        image_region=image_region,
        components=components.shares,
        memory_index=components.memory_index,
        evidence=dict(zip(names, estimates[0].evidence.tolist(), strict=True)),
        size=float(np.sqrt(np.mean(np.concatenate(compute_relative_squares(estimates))))),
        smoothed=tuple(estimates),
        spectrum=spectrum,
        maps=tuple(maps),
    )


def _find_undriven_lines(spectrum: ResidualSpectrum | None, n_u: int) -> list[float]:
    """Frequencies of lines that no input drives."""
    if spectrum is None:
        return []
    undriven = []
    for line in spectrum.lines:
        at = int(np.argmin(np.abs(spectrum.frequency_hz - line.frequency_hz)))
        driven = np.max(spectrum.coherence[at, line.coordinate, :n_u], initial=0.0)
        if driven < spectrum.significant:
            undriven.append(line.frequency_hz)
    return undriven[:3]


def _assign_brief_events(
    components: ResidualComponents, events: Sequence[ResidualEvent], estimates: Sequence[LatentForceEstimate]
) -> ResidualComponents:
    """Attribute what nothing explains and what acts briefly to the outside.

    Left-out blocks cannot predict a brief event. If it acts at positions that the motion reaches at no other
    time, position may be its cause instead.
    """
    duration_s = sum(event.end_s - event.start_s for event in events)
    event_share = sum(event.share for event in events)
    open_share = components.shares["unexplained"] + components.shares["memory"]
    brief = duration_s < LOCALIZATION.max_event_time_share * sum(
        estimate.motion.duration_s for estimate in estimates
    )
    if open_share < 0.5 or event_share < LOCALIZATION.min_event_energy_share or not brief:
        return components
    cause = "conservative" if _acts_beyond_usual_positions(events, estimates) else "exogenous"
    moved = {
        "memory": 0.0,
        "unexplained": (1.0 - event_share) * open_share,
        cause: components.shares[cause] + event_share * open_share,
    }
    return ResidualComponents(components.shares | moved, components.memory_index)


def _acts_beyond_usual_positions(
    events: Sequence[ResidualEvent], estimates: Sequence[LatentForceEstimate]
) -> bool:
    """Whether most of the events' residual acts beyond the positions of all other times."""
    inside = [np.zeros(estimate.motion.n, dtype=bool) for estimate in estimates]
    for event in events:
        time_s = estimates[event.motion].motion.time_s
        inside[event.motion] |= (time_s >= event.start_s) & (time_s <= event.end_s)
    within, square = np.concatenate(inside), np.concatenate(compute_relative_squares(estimates))
    main = int(np.argmax(square.sum(axis=0)))
    q = np.concatenate([estimate.q[:, main] for estimate in estimates])
    low, high = np.quantile(q[~within], [0.005, 0.995])
    beyond = within & ((q < low) | (q > high))
    return bool(square[beyond, main].sum() > 0.5 * square[within, main].sum())


def _describe_regions(regions: Sequence[StateRegion], names: Sequence[str]) -> dict[str, Any]:
    """Regions by coordinate as plain values."""
    return {
        name: [
            {
                "position": list(region.position),
                "velocity": None if region.velocity is None else list(region.velocity),
                "mean": region.mean,
                "share": region.share,
                "p": region.p,
            }
            for region in regions
            if names[region.coordinate] == name
        ]
        for name in names
        if any(names[region.coordinate] == name for region in regions)
    }


def _decide_level(
    mechanics: Mechanics,
    estimates: Sequence[LatentForceEstimate],
    features: ResidualFeatures,
    share: np.ndarray,
    components: ResidualComponents,
    period_s: float,
    perception_suspect: bool,
) -> str:
    """Level of the gap: perception, chart, actuation or dynamics, in this order of precedence.

    Args:
        mechanics: the simulator's equations of motion.
        estimates: smoothed motions with their residuals.
        features: samples of the residual and what may explain it.
        share: share of the residual in each coordinate (d,).
        components: share of the residual by kind of term.
        period_s: the natural period [s].
        perception_suspect: whether the images themselves are known to be worse.
    """
    speed_noise = measure_speed_noise(estimates, period_s=period_s)
    if perception_suspect or (
        speed_noise.p < LOCALIZATION.max_speed_noise_p
        and speed_noise.share > LOCALIZATION.min_speed_noise_share
    ):
        return "perception"
    if share.max() > 0.0:
        main = int(np.argmax(share))
        distortion_share = compute_distortion_share(features, mechanics, estimates, main)
        force_share = max(
            compute_explained_share(features, main, features.groups[main][name]) for name in FEATURE_GROUPS
        )
        if (
            distortion_share > LOCALIZATION.min_chart_share
            and distortion_share > force_share + LOCALIZATION.min_chart_lead
        ):
            return "chart"
    explained_share = 1.0 - components.shares["unexplained"]
    if (
        components.shares["actuation"]
        > max(LOCALIZATION.min_actuation_share * explained_share, LOCALIZATION.min_actuation_residual_share)
        and components.largest == "actuation"
    ):
        return "actuation"
    return "dynamics"
