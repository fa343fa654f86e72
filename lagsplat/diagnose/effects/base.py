"""What an effect is: a name, parameters with priors, and the place where it enters the sim.

Every parameter is counted in a unit of the motion at hand (its rms, its speed, its period, the rms of an
input), so that the same prior serves any mechanism in any coordinates. The leading parameters, usually one,
are *amplitudes*: with amplitude zero the effect is not there.

What is believed of a parameter before a recording is looked at.
"""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.mechanics.model import Model

Kind = Literal[
    "acceleration",
    "coordinate",
    "velocity",
    "time",
    "rate",
    "frame",
    "input",
    "reach",
    "ratio",
    "log_ratio",
    "frequency",
    "per_coordinate",
    "cubic",
    "drift",
    "per_duration",
    "slowness",
]
Component = Literal["inertial", "conservative", "dissipative", "actuation", "exogenous", "memory"]
UNITS: Mapping[Kind, str] = {
    "acceleration": "{q}/s^2",
    "coordinate": "{q}",
    "velocity": "{q}/s",
    "time": "s",
    "rate": "1/s",
    "frame": "s",
    "input": "{u}",
    "reach": "{q}",
    "ratio": "1",
    "log_ratio": "1",
    "frequency": "Hz",
    "per_coordinate": "1/{q}",
    "cubic": "1/({q}^2 s^2)",
    "drift": "{q}/s",
    "per_duration": "1/s",
    "slowness": "s/{q}",
}


@dataclass(frozen=True)
class Scales:
    """Size of a motion along one direction and of the input of one channel."""

    coordinate: float
    """Root mean square of the distance from rest."""
    velocity: float
    """Root mean square of its rate [1/s]."""
    reach: float
    """Largest distance from rest that is reached on the side in question."""
    frame_s: float
    duration_s: float
    stiffness: float = 1.0
    """Second derivative of the potential at rest over the reference inertia [1/s^2]."""
    input: float = 1.0
    """Root mean square of the input."""
    input_reach: float = 1.0

    def of(self, kind: Kind) -> float:
        """The size of one unit of a parameter of ``kind``, in the units of the recording."""
        s, v = self.coordinate, self.velocity
        return {
            "acceleration": v * v / s,
            "coordinate": s,
            "velocity": v,
            "time": s / v,
            "rate": v / s,
            "frame": self.frame_s,
            "input": self.input,
            "reach": self.reach,
            "ratio": 1.0,
            "log_ratio": 1.0,
            "frequency": v / s,
            "per_coordinate": 1.0 / s,
            "cubic": v * v / s**4,
            "drift": s / self.duration_s,
            "per_duration": 1.0 / self.duration_s,
            "slowness": 1.0 / v,
        }[kind]


@dataclass(frozen=True)
class Normal:
    """A priori normal about ``mean``; the unknown is the parameter itself."""

    deviation: float
    mean: float = 0.0
    lowest: float = -math.inf

    def value(self, x: Any) -> Any:
        """The parameter of unknown ``x``."""
        return x

    def unknown(self, value: float) -> float:
        """The unknown of a parameter."""
        return value

    def log_density(self, x: float) -> float:
        """Logarithm of the density of the unknown."""
        z = (x - self.mean) / self.deviation
        return -0.5 * z * z - math.log(self.deviation * math.sqrt(2.0 * math.pi))


@dataclass(frozen=True)
class EffectParameter:
    """One parameter: its key in a diagnosis, what it is counted in, what is believed of it beforehand."""

    name: str
    kind: Kind
    prior: Normal
    grid: tuple[float, ...] = ()
    """Values that the search tries first; empty for an amplitude."""


@dataclass(frozen=True)
class Effect:
    """One entry of the catalogue."""

    name: str
    group: str
    """A parameter, B dissipation, C actuation, D memory, E contact or external, F structure, G camera."""
    equation: str
    parameters: tuple[EffectParameter, ...]
    needs: str = ""
    """What a recording must contain to show it."""
    amplitudes: int = 1
    component: Component | None = None
    """The term of the equations of motion that it belongs to; None for camera and clock."""
    level: Literal["perception", "chart", "actuation", "dynamics"] = "dynamics"
    """Where on the way from picture to motion it acts."""
    passive: bool = False
    """Never feeds energy into the mechanism."""
    variants: tuple[str, ...] = ("",)
    variant_units: Mapping[str, str] = field(default_factory=dict)  # where not of the parameters' kind
    along: Literal["coordinates", "whole", "both", "channels"] = "coordinates"
    together: bool = False
    """May act at all of its places at once, with parameters of its own at each."""
    between: tuple[str, ...] = ()
    """Variants that may act between two coordinates: in the joint of bodies that are told each by itself."""
    reports: Callable[[Mapping[str, float], "PlacedEffect"], dict[str, Any]] | None = None
    """From the fitted parameters to those of a diagnosis, where they differ."""


@dataclass(frozen=True)
class ForceEffect(Effect):
    """An effect that is a force along one direction: see `lagsplat.diagnose.solvers.runge_kutta` for the law."""

    law: Any = None
    n_memory: int = 0
    memory_start: tuple[str, ...] = ()
    """What each memory holds where a clip begins: ``zero``, ``s`` or ``v``."""
    memory_kinds: tuple[Kind, ...] = ()
    """What each memory is counted in, if it may begin elsewhere where a clip begins in mid-motion."""
    free_clips: tuple[int, ...] = ()
    """Clips whose memory begins by as much beside ``memory_start`` as the last parameters say."""
    constants: Callable[[Scales, str], tuple[float, ...]] = field(default=lambda scales, variant: ())
    """What the law gets after its parameters."""
    whole: Any = None
    """``whole(fields, theta (P, k), model)``: the same on all coordinates at once, as a change of the sim."""

    @property
    def n_law(self) -> int:
        """Number of parameters that the law takes; those after them say where its memory begins."""
        return len(self.parameters) - self.n_memory * len(self.free_clips)

    def begun(self, clips: Sequence[int]) -> "ForceEffect":
        """The same with a memory that begins anywhere in ``clips``."""
        own = (
            EffectParameter(f"memory {i} of clip {c}", kind, Normal(1.0), (0.0,))
            for c in clips
            for i, kind in enumerate(self.memory_kinds)
        )
        return replace(self, parameters=(*self.parameters[: self.n_law], *own), free_clips=tuple(clips))


@dataclass(frozen=True)
class CoefficientBatch:
    """Coefficients of the sim for ``P`` sets of parameters at once; the names are those of `Model`."""

    mass: Float64[np.ndarray, "P Km d d"]
    damping: Float64[np.ndarray, "P Kc d d"]
    potential: Float64[np.ndarray, "P Kv"]
    input_map: Float64[np.ndarray, "P Kb n_u d"]
    dry: Float64[np.ndarray, "P d"]
    drag: Float64[np.ndarray, "P d"]


@dataclass(frozen=True)
class ModelEffect(Effect):
    """An effect that changes the sim's coefficients: ``change(fields, theta (P, k), instance, model)``."""

    change: Any = None


@dataclass(frozen=True)
class InputEffect(Effect):
    """An effect on the way of an input: ``change(signal, channel, theta (P, k)) -> (P, M)`` samples."""

    change: Any = None


@dataclass(frozen=True)
class ObservationEffect(Effect):
    """An effect of camera or clock: ``observe(y, v, t, theta (P, k), instance) -> y``."""

    observe: Any = None


@dataclass(frozen=True)
class SampleEffect(Effect):
    """An effect that moves single samples and nothing else.

    ``explain(residual, speed) -> (gain, parameters, misfit)``: by how much the log likelihood of a fit's
    residual (n, d) grows [nat] if it is there, both in units of the noise, ``speed`` a frame; its best
    parameters; and the sum of squares that it leaves. ``repeats`` says that samples are its making which show
    again what an earlier one showed.
    """

    explain: Any = None
    repeats: bool = False


@dataclass(frozen=True)
class Direction:
    """A way to push: the covector ``p`` with its reference inertia, ``s = p.(q - rest)``."""

    name: str | None
    covector: Float64[np.ndarray, " d"]
    inertia: float
    rest: float = 0.0
    """``p.rest``."""


@dataclass(frozen=True)
class PlacedEffect:
    """One effect at one place: along a direction, on a channel, or on the whole."""

    effect: Effect
    scales: Scales
    variant: str = ""
    direction: Direction | None = None
    channel: int | None = None
    input_name: str | None = None
    grid: tuple[tuple[float, ...], ...] | None = None
    """Values of all but the amplitudes that the search tries first, in place of their own grids."""
    parts: tuple["PlacedEffect", ...] = ()
    """Where it acts at several places at once: each of them, in the order of the parameters."""

    @property
    def label(self) -> str:
        """For people: the effect and its place."""
        everywhere = "everywhere" if self.parts else None
        return " ".join(p for p in (self.effect.name, self.place, self.variant, everywhere) if p)

    @property
    def place(self) -> str | None:
        """The coordinate or the input where it acts; None on the whole and everywhere."""
        return self.direction.name if self.direction else self.input_name

    def physical(self, x: Float64[np.ndarray, "P k"]) -> Float64[np.ndarray, "P k"]:
        """Parameters in the units of the recording, for unknowns ``x``."""
        if self.parts:
            split = np.split(x, len(self.parts), axis=1)
            return np.concatenate(
                [part.physical(own) for part, own in zip(self.parts, split, strict=True)], 1
            )
        columns = [
            p.prior.value(x[:, i]) * self.scales.of(p.kind) for i, p in enumerate(self.effect.parameters)
        ]
        return np.stack(columns, axis=1) if columns else np.zeros((len(x), 0))


def place_everywhere(places: Sequence[PlacedEffect]) -> PlacedEffect:
    """One effect at all of ``places`` at once, its parameters after the place that each belongs to.

    Its parameters are all amplitudes, or none is; then the search begins with the same at every place.
    """
    effect, n = places[0].effect, len(places)
    own = [replace(p, name=f"{p.name} {one.place}") for one in places for p in effect.parameters]
    whole = replace(effect, parameters=tuple(own), amplitudes=n * effect.amplitudes)
    same = [point * n for point in itertools.product(*(p.grid for p in effect.parameters))]
    grid = None if effect.amplitudes else tuple(same)
    return PlacedEffect(whole, places[0].scales, places[0].variant, grid=grid, parts=tuple(places))


FARTHEST = 690.0
"""Largest logarithm whose exponential is neither zero nor infinite."""


@dataclass(frozen=True)
class HalfNormal(Normal):
    """A priori half-normal: never negative."""

    lowest: float = 0.0

    def log_density(self, x: float) -> float:
        """Logarithm of the density of the unknown."""
        return Normal.log_density(self, x) + math.log(2.0)


@dataclass(frozen=True)
class LogNormal(Normal):
    """A priori log-normal; the unknown is the logarithm. ``mean`` is that of the logarithm."""

    def value(self, x: Any) -> Any:
        """The parameter of unknown ``x``; never zero, since laws divide by it."""
        return np.exp(np.clip(x, -FARTHEST, FARTHEST))

    def unknown(self, value: float) -> float:
        """The unknown of a parameter."""
        return math.log(value)


def log_normal(median: float, spread: float) -> LogNormal:
    """Log-normal with this median and this standard deviation of the logarithm."""
    return LogNormal(spread, math.log(median))


def make_direction(name: str | None, covector: Float64[np.ndarray, " d"], model: Model) -> Direction:
    """A covector with the inertia and the rest that a sim has along it."""
    along = covector / float(covector @ covector)
    return Direction(name, covector, float(along @ model.inertia @ along), float(covector @ model.rest))
