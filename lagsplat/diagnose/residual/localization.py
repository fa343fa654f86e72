"""Where the gap between a simulator and a recording lies: in which coordinates, when, and at which states."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.residual.change_points import find_events
from lagsplat.diagnose.residual.latent_force import (
    LatentForceEstimate,
    compute_coordinate_shares,
    estimate_latent_force,
)
from lagsplat.diagnose.residual.spectrum import ResidualSpectrum, compute_spectrum
from lagsplat.diagnose.residual.state_maps import StateMap, StateRegion, find_state_regions
from lagsplat.io.trajectory.trajectory import Trajectory


@dataclass(frozen=True)
class ResidualLocation:
    """Where a gap lies; shares are of the squared residual over the mean squared acceleration."""

    coordinates: dict[str, float]  # share by name
    time_s: tuple[tuple[str, float, float, float], ...]  # events: file, start [s], end [s], share
    frequency_hz: tuple[tuple[float, float, float], ...]  # bands: low [Hz], high [Hz], share
    state_region: dict[str, Any]  # by coordinate, the boxes in which the residual keeps its sign
    evidence: dict[str, float]  # nats by which each coordinate's residual force makes the recording likelier
    smoothed: tuple[LatentForceEstimate, ...]
    spectrum: ResidualSpectrum | None  # None where clips are short
    maps: tuple[StateMap, ...]
    components: Mapping[str, float] = field(default_factory=dict)  # probability of a cause by kind of term
    level: str = "dynamics"  # of the likeliest cause; or "perception", "chart", "actuation"
    image_region: dict[str, Any] | None = None  # as of `describe_image_region`; None without images


def locate(
    mechanics: MechanicalModel,
    motions: Sequence[Trajectory],
    *,
    period_s: float,
    hold: str = "linear",
) -> ResidualLocation:
    """Locate the force that ``mechanics`` lacks on ``motions``.

    Args:
        mechanics, motions, hold: as of `estimate_latent_force`.
        period_s: the natural period [s].

    Raises:
        ValueError: as `estimate_latent_force`.
    """
    estimates = estimate_latent_force(mechanics, motions, period_s=period_s, hold=hold)
    coordinate_share = compute_coordinate_shares(estimates)
    spectrum = compute_spectrum(estimates, period_s=period_s)
    events = find_events(estimates, period_s=period_s)
    regions, maps = find_state_regions(estimates, period_s=period_s)
    names = motions[0].q_names
    return ResidualLocation(
        coordinates=dict(zip(names, coordinate_share.tolist(), strict=True)),
        time_s=tuple((motions[e.motion].source, e.start_s, e.end_s, e.share) for e in events),
        frequency_hz=() if spectrum is None else spectrum.bands,
        state_region=_describe_regions(regions, names),
        evidence=dict(zip(names, estimates[0].evidence.tolist(), strict=True)),
        smoothed=tuple(estimates),
        spectrum=spectrum,
        maps=tuple(maps),
    )


def _describe_regions(regions: Sequence[StateRegion], names: Sequence[str]) -> dict[str, Any]:
    """Regions by coordinate, in the order of ``names``, as plain values."""
    found: dict[str, list] = {name: [] for name in names}
    for region in regions:
        values = asdict(region)
        found[names[values.pop("coordinate")]].append(values)
    return {name: described for name, described in found.items() if described}
