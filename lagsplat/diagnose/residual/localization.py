"""Where the gap between a simulator and a recording lies: `locate` collects what the room finds."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from lagsplat.diagnose.core.config import LOCALIZATION
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.residual.change_points import ResidualEvent, find_events
from lagsplat.diagnose.residual.components import compute_components, compute_explained_share
from lagsplat.diagnose.residual.features import FEATURE_GROUPS, ResidualFeatures, compute_features
from lagsplat.diagnose.residual.latent_force import (
    LatentForceEstimate,
    compute_coordinate_shares,
    compute_relative_squares,
    estimate_latent_force,
)
from lagsplat.diagnose.residual.measurement_model import compute_apparent_forces, measure_speed_noise
from lagsplat.diagnose.residual.spectrum import ResidualSpectrum, compute_spectrum
from lagsplat.diagnose.residual.state_maps import StateMap, StateRegion, find_state_regions
from lagsplat.io.trajectory.trajectory import Trajectory


@dataclass(frozen=True)
class ResidualLocation:
    """Where a gap lies; shares are of the squared residual over the mean squared acceleration."""

    level: str  # "perception", "chart", "actuation" or "dynamics"
    coordinates: dict[str, float]  # share by name
    time_s: tuple[tuple[str, float, float, float], ...]  # events: file, start [s], end [s], share
    frequency_hz: tuple[tuple[float, float, float], ...]  # bands: low [Hz], high [Hz], share
    state_region: dict[str, Any]  # by coordinate, the boxes in which the residual keeps its sign
    components: dict[str, float]  # share by kind of term, with "unexplained"
    evidence: dict[str, float]  # nats by which each coordinate's residual force makes the recording likelier
    smoothed: tuple[LatentForceEstimate, ...]
    spectrum: ResidualSpectrum | None  # None where clips are short
    maps: tuple[StateMap, ...]
    image_region: dict[str, Any] | None = None  # as of `describe_image_region`; None without images


def locate(
    mechanics: MechanicalModel,
    motions: Sequence[Trajectory],
    *,
    period_s: float,
    hold: str = "linear",
    perception_suspect: bool = False,
) -> ResidualLocation:
    """Locate the force that ``mechanics`` lacks on ``motions``.

    Args:
        mechanics, motions, hold: as of `estimate_latent_force`.
        period_s: the natural period [s].
        perception_suspect: images are read worse than those that the simulator was fitted to, which makes
            perception the level in any case.

    Raises:
        ValueError: as `estimate_latent_force`.
    """
    estimates = estimate_latent_force(mechanics, motions, period_s=period_s, hold=hold)
    coordinate_share = compute_coordinate_shares(estimates)
    spectrum = compute_spectrum(estimates, period_s=period_s)
    lines_hz = _find_undriven_lines(spectrum, motions[0].n_u) if spectrum is not None else []
    features = compute_features(mechanics, estimates, period_s=period_s, lines_hz=lines_hz)
    events = find_events(estimates, period_s=period_s)
    shares = compute_components(features, coordinate_share)
    shares = _assign_brief_events(shares, events, estimates)
    regions, maps = find_state_regions(estimates, period_s=period_s)
    names = motions[0].q_names
    noise = measure_speed_noise(estimates, period_s=period_s)
    is_noise = noise.p < LOCALIZATION.max_speed_noise_p and noise.share > LOCALIZATION.min_speed_noise_share
    level = "perception"
    if not (perception_suspect or is_noise):
        level = _decide_level(mechanics, estimates, features, coordinate_share, shares)
    return ResidualLocation(
        level=level,
        coordinates=dict(zip(names, coordinate_share.tolist(), strict=True)),
        time_s=tuple((motions[e.motion].source, e.start_s, e.end_s, e.share) for e in events),
        frequency_hz=() if spectrum is None else spectrum.bands,
        state_region=_describe_regions(regions, names),
        components=shares,
        evidence=dict(zip(names, estimates[0].evidence.tolist(), strict=True)),
        smoothed=tuple(estimates),
        spectrum=spectrum,
        maps=tuple(maps),
    )


def _find_undriven_lines(spectrum: ResidualSpectrum, n_u: int) -> list[float]:
    """Frequencies of the clearest lines that no input drives."""
    undriven = []
    for line in spectrum.lines:
        at = int(np.argmin(np.abs(spectrum.frequency_hz - line.frequency_hz)))
        driven = np.max(spectrum.coherence[at, line.coordinate, :n_u], initial=0.0)
        if driven < spectrum.significant:
            undriven.append(line.frequency_hz)
    return undriven[:3]


def _assign_brief_events(
    shares: dict[str, float], events: Sequence[ResidualEvent], estimates: Sequence[LatentForceEstimate]
) -> dict[str, float]:
    """Attribute what nothing explains and what acts briefly to the outside.

    Left-out blocks cannot predict a brief event. If it acts at positions that the motion reaches at no other
    time, position may be its cause instead.
    """
    duration_s = sum(event.end_s - event.start_s for event in events)
    event_share = sum(event.share for event in events)
    open_share = shares["unexplained"] + shares["memory"]
    recorded_s = sum(estimate.motion.duration_s for estimate in estimates)
    brief = duration_s < LOCALIZATION.max_event_time_share * recorded_s
    if open_share < 0.5 or event_share < LOCALIZATION.min_event_energy_share or not brief:
        return shares
    cause = "conservative" if _acts_beyond_usual_positions(events, estimates) else "exogenous"
    moved = {"memory": 0.0, "unexplained": (1.0 - event_share) * open_share}
    moved[cause] = shares[cause] + event_share * open_share
    return shares | moved


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
    """Regions by coordinate, in the order of ``names``, as plain values."""
    found: dict[str, list] = {name: [] for name in names}
    for region in regions:
        values = asdict(region)
        found[names[values.pop("coordinate")]].append(values)
    return {name: described for name, described in found.items() if described}


def _decide_level(
    mechanics: MechanicalModel,
    estimates: Sequence[LatentForceEstimate],
    features: ResidualFeatures,
    coordinate_share: np.ndarray,
    shares: dict[str, float],
) -> str:
    """Level of a gap that is not in the images: chart, actuation or dynamics, in this order of precedence."""
    if coordinate_share.max() > 0.0:
        main = int(np.argmax(coordinate_share))
        distortions = compute_apparent_forces(mechanics, estimates, main)[features.picked]
        distortion_share = compute_explained_share(features, main, distortions)
        groups = (features.groups[main][name] for name in FEATURE_GROUPS)
        force_share = max(compute_explained_share(features, main, columns) for columns in groups)
        if distortion_share > max(LOCALIZATION.min_chart_share, force_share + LOCALIZATION.min_chart_lead):
            return "chart"
    limit = LOCALIZATION.min_actuation_share * (1.0 - shares["unexplained"])
    largest = max(FEATURE_GROUPS, key=lambda name: shares[name])
    if largest == "actuation" and shares[largest] > max(limit, LOCALIZATION.min_actuation_residual_share):
        return "actuation"
    return "dynamics"
