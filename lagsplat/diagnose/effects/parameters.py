"""Parameters of effects: what they are counted in, and what is believed of them before a recording is seen.

A parameter is counted in a unit of the recorded motion (its rms, its speed, its period, the rms of an input).
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from lagsplat.diagnose.solvers.dry_friction import PRESLIDING_SHARE


@dataclass(frozen=True)
class Scales:
    """Sizes of a motion along one direction, and of one input; they make up the units of parameters."""

    coordinate: float  # root mean square of the distance from rest
    velocity: float  # root mean square of its rate [1/s]
    reach: float  # largest distance from rest that is reached on the side in question
    frame_s: float  # median time between two samples [s]
    duration_s: float  # length of the recording [s]
    stiffness: float = 1.0  # second derivative of the potential at rest over the reference inertia [1/s^2]
    input: float = 1.0  # root mean square of the input
    drive: float = 1.0  # root mean square of the acceleration that the inputs give [1/s^2]

    def of(self, kind: str) -> float:
        """The size of one unit of a parameter of ``kind``, in the units of the recording."""
        return PARAMETER_KINDS[kind][1](self)


PARAMETER_KINDS: Mapping[str, tuple[str, Callable[[Scales], float]]] = {
    # what moves slowly against a spring is held by far larger forces than its own inertia tells
    "acceleration": ("{q}/s^2", lambda s: max(s.velocity**2 / s.coordinate, s.stiffness * s.coordinate)),
    "drive": ("{q}/s^2", lambda s: s.drive),
    "coordinate": ("{q}", lambda s: s.coordinate),
    "velocity": ("{q}/s", lambda s: s.velocity),
    "time": ("s", lambda s: s.coordinate / s.velocity),
    "rate": ("1/s", lambda s: s.velocity / s.coordinate),
    "frame": ("s", lambda s: s.frame_s),
    "input": ("{u}", lambda s: s.input),
    "reach": ("{q}", lambda s: s.reach),
    "ratio": ("1", lambda s: 1.0),
    "log_ratio": ("1", lambda s: 1.0),
    "per_coordinate": ("1/{q}", lambda s: 1.0 / s.coordinate),
    "cubic": ("1/({q}^2 s^2)", lambda s: s.velocity * s.velocity / s.coordinate**4),
    "drift": ("{q}/s", lambda s: s.coordinate / s.duration_s),
    "per_duration": ("1/s", lambda s: 1.0 / s.duration_s),
    "slowness": ("s/{q}", lambda s: 1.0 / s.velocity),
}
"""Unit of each kind in a diagnosis, and the size of one unit of the fit in it."""
UNITS = {kind: unit for kind, (unit, _) in PARAMETER_KINDS.items()}


@dataclass(frozen=True)
class Normal:
    """Normal prior; the unknown of the fit is the parameter itself."""

    deviation: float
    mean: float = 0.0
    lowest: float = -math.inf  # smallest value that the unknown may take

    def value(self, x: Any) -> Any:
        """The parameter of unknown ``x``."""
        return x

    def unknown(self, value: float) -> float:
        """The unknown of a parameter."""
        return value

    def log_density(self, x: float) -> float:
        """Logarithm of the density of the unknown, which is at least `lowest`."""
        z = (x - self.mean) / self.deviation
        possible = 0.5 * math.erfc((self.lowest - self.mean) / (self.deviation * math.sqrt(2.0)))
        return -0.5 * z * z - math.log(self.deviation * math.sqrt(2.0 * math.pi)) - math.log(possible)


@dataclass(frozen=True)
class HalfNormal(Normal):
    """Half-normal prior: the parameter is never negative."""

    lowest: float = 0.0


LARGEST_EXPONENT = 690.0  # largest logarithm whose exponential is neither zero nor infinite


@dataclass(frozen=True)
class LogNormal(Normal):
    """Log-normal prior; the unknown of the fit is the logarithm, of which ``mean`` and ``deviation`` are."""

    def value(self, x: Any) -> Any:
        """The parameter of unknown ``x``; never zero, since laws divide by it."""
        return np.exp(np.clip(x, -LARGEST_EXPONENT, LARGEST_EXPONENT))

    def unknown(self, value: float) -> float:
        """The unknown of a parameter."""
        return math.log(value)


def log_normal(median: float, spread: float) -> LogNormal:
    """Log-normal with this median and this standard deviation of the logarithm."""
    return LogNormal(spread, math.log(median))


@dataclass(frozen=True)
class EffectParameter:
    """One parameter: its key in a diagnosis, what it is counted in, and its prior."""

    name: str
    kind: str  # a key of `PARAMETER_KINDS`
    prior: Normal
    grid: tuple[float, ...] = ()  # values that the search tries first; empty for an amplitude
    label: str = ""  # how it is called in a sentence, by default its name
    reported: bool = True  # shown in a diagnosis; what only a recording or an approximation has is not


PRESLIDING = (
    EffectParameter(
        "presliding",
        "coordinate",
        log_normal(PRESLIDING_SHARE, 2.0),
        (0.0003, 0.01),
        label="presliding displacement",
    ),
    EffectParameter("bristle_damping", "ratio", log_normal(0.3, 2.0), (0.3,), reported=False),
)
"""How far dry friction gives way before it slides, and the damping of that over ``sqrt(stiffness mass)``.

The damping is 1 in Canudas de Wit et al., 1995, doi:10.1109/9.376053, and 0 in the model of Dahl (1968) that
theirs contains.
"""
