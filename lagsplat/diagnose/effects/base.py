"""What an effect is: a name, parameters with priors, and the place where it enters the sim.

Every parameter is counted in a unit of the motion at hand (its rms, its speed, its period, the rms of an
input), so that the same prior serves any mechanism in any coordinates. The leading parameters, usually one,
are *amplitudes*: with amplitude zero the effect is not there.

What is believed of a parameter before a recording is looked at.
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.parameters import EffectParameter, Normal, ParameterKind, Scales
from lagsplat.diagnose.mechanics.model import MechanicalModel

Component = Literal["inertial", "conservative", "dissipative", "actuation", "exogenous", "memory"]


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
    memory_kinds: tuple[ParameterKind, ...] = ()
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
    """Coefficients of the sim for ``P`` sets of parameters at once; the names are those of `MechanicalModel`."""

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


def make_direction(
    name: str | None, covector: Float64[np.ndarray, " d"], model: MechanicalModel
) -> Direction:
    """A covector with the inertia and the rest that a sim has along it."""
    along = covector / float(covector @ covector)
    return Direction(name, covector, float(along @ model.inertia @ along), float(covector @ model.rest))


@dataclass(frozen=True)
class DisturbanceHints:
    """Where to look for disturbances: pushes (start, end) [s] on the joint clock, and lines [Hz]."""

    pushes: tuple[tuple[float, float], ...]
    lines_hz: tuple[float, ...]
