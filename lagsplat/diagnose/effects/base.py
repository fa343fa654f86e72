"""What an effect of the catalogue is, and how it is placed on a mechanism.

An effect is a law with parameters and everything else that a diagnosis needs to know of it. One file defines
one effect and names it `EFFECT`; see `lagsplat.diagnose.effects.friction.coulomb_friction` for a short one to
copy, and `lagsplat.diagnose.effects.registry` for how the catalogue finds it.

Parameters are counted in units of the recorded motion (`lagsplat.diagnose.effects.parameters`), so that one
prior serves any mechanism in any coordinates. Some parameters, usually one, are *amplitudes*: with amplitude
zero the effect is absent. The others are its shape.
"""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Self

import numpy as np
from jaxtyping import Float64, Int64

from lagsplat.diagnose.effects.parameters import PRESLIDING, EffectParameter, Normal, Scales
from lagsplat.diagnose.mechanics.model import MechanicalModel

Component = Literal["inertial", "conservative", "dissipative", "actuation", "exogenous", "memory"]
Level = Literal["perception", "chart", "actuation", "dynamics"]
Kind = Literal["parameter", "mechanism", "outside", "observation", "verdict"]


@dataclass(frozen=True, kw_only=True)
class EffectDescription:
    """An effect in words that need no training in mechanics."""

    title: str  # completes "the cause is ..."
    kind: Kind = "mechanism"
    """A number of the simulation that is off (which a fit to the same recording absorbs), physics that it
    lacks, something that acts on the mechanism from elsewhere, or sensor and clock; "verdict" for `none` and
    `unknown`."""
    what: str  # what the effect is, one sentence
    symptom: str  # how it shows in a recording, one sentence
    remedy: str  # what to do about it, one sentence
    short_title: str = ""  # its name in a label, by default the effect's name with spaces for underscores


@dataclass(frozen=True, kw_only=True)
class Effect(EffectDescription):
    """One entry of the catalogue; use one of the five subclasses, which say where the effect enters."""

    name: str
    group: str
    """A parameter, B dissipation, C actuation, D memory, E contact or external, F structure, G sensor."""
    number: int = 100  # position within the group wherever effects are listed for people
    equation: str
    parameters: tuple[EffectParameter, ...]
    needs: str = ""  # what a recording must contain to reveal it
    mujoco: Callable[[Any, Mapping[str, Any]], tuple[str, ...]] | str
    """``mujoco(element, values)`` writes the effect into a MuJoCo model and returns what it changed, or
    nothing if it cannot; ``element`` is a `lagsplat.diagnose.augmented.mujoco_export.MujocoElement`, with the
    joint or actuator where the effect acts. Instead of a function, a clause that says why MuJoCo has none."""
    confusable_with: tuple[str, ...] = ()
    """Effects that some recordings cannot separate from this one; one of two may name the other alone."""
    flexible: bool = False
    """Has times, frequencies, wave numbers or states of its own, so that two such effects fit almost
    anything."""
    recurrence: Callable[[Mapping[str, float], Any, "PlacedEffect"], float] | None = None
    """Of an external effect, given the dataset: how far the state does not tell the force, from 0 to 1."""
    recorded_by: Literal["film", "log"] | None = None  # kind of recording that may show it; None for both
    camera: Literal["moved between recordings", "moves while recording", "shutter"] | None = None
    needs_all_forces: bool = False
    """Reads forces, or moves masses, that coordinates share: it is not fitted to one of them alone, where an
    input was computed along the motion of the others (`Trajectory.computed`)."""
    component: Component | None = None  # term of the equations of motion; None for sensor and clock
    level: Level = "dynamics"  # where on the way from image to motion it acts
    variants: tuple[str, ...] = ("",)
    variant_units: Mapping[str, str] = field(default_factory=dict)
    """Unit of a variant's parameters where it is not that of their kind."""
    along: Literal["each", "whole", "both", "pairs"] = "each"
    """Acts on each coordinate or input, on all at once, on both (all at once in the first variant alone), or
    between each two coordinates."""
    acts_everywhere: bool = False  # may act at all its places at once, with parameters of its own at each
    between_variants: tuple[str, ...] = ()
    """Variants that may also act between two coordinates: in the joint of two bodies."""
    place: Callable[[Any, "PlaceFinder"], list["PlacedEffect"]] | None = None
    """``place(effect, finder)``: the places where it may act, where ``along`` does not say it."""
    report_parameters: Callable[[Mapping[str, float], "PlacedEffect"], dict[str, Any]] | None = None
    """The parameters of a diagnosis, where they are not those fitted; ``times`` by the dataset's clock."""
    report_units: Mapping[str, str] = field(default_factory=dict)
    """Units of reported parameters that are not parameters of the fit."""
    free_clips: tuple[int, ...] = ()
    """Clips whose memories begin off where they would, by what the last parameters say."""

    @property
    def amplitudes(self) -> Int64[np.ndarray, " n"]:
        """Which parameters are amplitudes: those without a grid of values."""
        return np.flatnonzero([not p.grid for p in self.parameters])

    @property
    def shapes(self) -> Int64[np.ndarray, " m"]:
        """Which parameters are no amplitudes."""
        return np.flatnonzero([len(p.grid) > 0 for p in self.parameters])

    @property
    def memory_kinds(self) -> tuple[str, ...]:
        """What each memory that may begin anywhere is counted in."""
        return ()

    @property
    def n_law(self) -> int:
        """Number of parameters that the law takes; those after them say where its memory begins."""
        return len(self.parameters) - len(self.memory_kinds) * len(self.free_clips)

    def with_free_memory(self, clips: Sequence[int]) -> Self:
        """The same effect with a memory that may begin anywhere in ``clips``."""
        beginnings = (
            EffectParameter(f"memory {i} of clip {c}", kind, Normal(1.0), (0.0,), reported=False)
            for c in clips
            for i, kind in enumerate(self.memory_kinds)
        )
        return replace(
            self, parameters=(*self.parameters[: self.n_law], *beginnings), free_clips=tuple(clips)
        )


@dataclass(frozen=True, kw_only=True)
class ForceEffect(Effect):
    """A force along one direction: see `lagsplat.diagnose.solvers.force_laws` for the law."""

    law: Any
    memory_start: tuple[Literal["zero", "s", "v"], ...] = ()
    """What each memory holds where a clip begins. What starts as ``s`` or ``v`` may begin elsewhere where a
    clip begins in mid-motion."""
    constants: Callable[[Scales, str], tuple[float, ...]] = field(default=lambda scales, variant: ())
    """What the law gets after its parameters."""
    dry: tuple[str, ...] = ()
    """Variants that are dry friction, with the `PRESLIDING` parameters: their law is what acts in motion."""
    crosswise: bool = False
    """Couples the two coordinates of a pair: it acts on each by the other's motion, with opposite signs."""
    whole: Any = None
    """``whole(coefficients, theta (P, k), model)``: the same on all coordinates, as a change of the model."""

    @property
    def n_memory(self) -> int:
        """Number of memories of the law; the bristles of dry friction have one."""
        return 1 if self.dry else len(self.memory_start)

    @property
    def presliding(self) -> int:
        """Which parameter is the presliding displacement of dry friction."""
        return next(i for i, p in enumerate(self.parameters) if p.name == PRESLIDING[0].name)

    @property
    def memory_kinds(self) -> tuple[str, ...]:
        """What each memory is counted in that begins at the motion's ``s`` or ``v``."""
        kinds = {"s": "coordinate", "v": "velocity"}
        return tuple(kinds[start] for start in self.memory_start if start in kinds)


@dataclass(frozen=True)
class CoefficientBatch:
    """Coefficients of a `MechanicalModel`, under the same names, for ``P`` sets of parameters at once."""

    mass: Float64[np.ndarray, "P Km d d"]
    damping: Float64[np.ndarray, "P Kc d d"]
    potential: Float64[np.ndarray, "P Kv"]
    input_map: Float64[np.ndarray, "P Kb n_u d"]
    dry: Float64[np.ndarray, "P d"]
    drag: Float64[np.ndarray, "P d"]


@dataclass(frozen=True, kw_only=True)
class ModelEffect(Effect):
    """A change of the model: ``change(coefficients, theta (P, k), placed, model) -> coefficients``."""

    change: Callable[..., CoefficientBatch]


@dataclass(frozen=True, kw_only=True)
class InputEffect(Effect):
    """A change of an input on its way: ``change(signal, theta (P, k)) -> (P, M)`` samples of the input.

    One that remembers what came before (``memory``) also takes how far from its command it begins each clip,
    (P, C) in the input's unit: ``change(signal, theta, start)``.
    """

    change: Callable[..., np.ndarray]
    memory: bool = False
    time_shift: str = ""  # the parameter by which it shifts the input in time [s], if it does only that
    component: Component | None = "actuation"
    level: Level = "actuation"

    @property
    def memory_kinds(self) -> tuple[str, ...]:
        """The unit of the input, where it has a memory."""
        return ("input",) if self.memory else ()

    def change_input(self, signal: Any, theta: Float64[np.ndarray, "P k"]) -> Float64[np.ndarray, "P M"]:
        """The input with its changes, for ``P`` sets of parameters and beginnings of its memory."""
        if not self.memory:
            return self.change(signal, theta)
        start = np.zeros((len(theta), len(signal.logged)))
        start[:, list(self.free_clips)] = theta[:, self.n_law :]
        return self.change(signal, theta[:, : self.n_law], start)


@dataclass(frozen=True, kw_only=True)
class ObservationEffect(Effect):
    """An effect of the sensor: ``observe(y, v, t, theta (P, k), placed) -> y``, all (P, W, L, d)."""

    observe: Callable[..., np.ndarray]
    kind: Kind = "observation"
    group: str = "G"
    level: Level = "chart"
    mujoco: str = "it concerns the sensor of the recording, not the mechanism."


@dataclass(frozen=True, kw_only=True)
class SampleEffect(Effect):
    """An effect that moves single samples and nothing else.

    ``explain(residual, speed) -> (gain, parameters, misfit)``: by how much the log likelihood of a fit's
    residual (n, d) grows [nat] with the effect, its best parameters with the ends of their 90 % intervals,
    and the sum of squares that it leaves. ``residual`` is in units of the noise, ``speed`` in these a frame.
    """

    explain: Any
    repeats: bool = False  # it makes samples that repeat an earlier one
    kind: Kind = "observation"
    group: str = "G"
    level: Level = "perception"
    along: Literal["each", "whole", "both"] = "whole"


@dataclass(frozen=True)
class Direction:
    """A direction of force: the covector ``p`` with its reference inertia; ``s = p.(q - rest)``."""

    name: str | None
    covector: Float64[np.ndarray, " d"]
    inertia: float
    rest: float = 0.0  # `p.rest`

    @classmethod
    def of(cls, name: str | None, covector: Float64[np.ndarray, " d"], model: MechanicalModel) -> "Direction":
        """A covector with the inertia and the rest that a model has along it."""
        along = covector / float(covector @ covector)
        return cls(name, covector, float(along @ model.inertia @ along), float(covector @ model.rest))

    def shift(self, y: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Coordinates ``y`` (..., d) moved by ``s`` (...) along the direction."""
        return y + s[..., None] * (self.covector / (self.covector @ self.covector))


@dataclass(frozen=True)
class PlacedEffect:
    """One effect at one place: along a direction, on an input, or on the whole."""

    effect: Effect
    scales: Scales
    variant: str = ""
    direction: Direction | None = None
    channel: int | None = None
    input_name: str | None = None
    grid: tuple[tuple[float, ...], ...] | None = None
    """Values of all but the amplitudes that the search tries first, in place of the parameters' own grids."""
    constants: tuple[float, ...] = ()  # what a law gets last, where that depends on the place
    spared: tuple[int, ...] = ()
    """Channels that an effect of all inputs leaves alone, as they were computed and not logged."""
    parts: tuple["PlacedEffect", ...] = ()
    """Where it acts at several places at once: each of them, in the order of the parameters."""

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self.effect.parameters)

    def list_channels(self, n_u: int) -> list[int]:
        """The channels of ``n_u`` inputs that an effect on inputs changes."""
        if self.channel is not None:
            return [self.channel]
        return [channel for channel in range(n_u) if channel not in self.spared]

    @property
    def changes_motion(self) -> bool:
        """Whether a rollout shows it; single samples that an effect moves are in no rollout."""
        return not isinstance(self.effect, SampleEffect)

    @property
    def location(self) -> str | None:
        """The coordinate or the input where it acts; None on the whole and everywhere."""
        return self.direction.name if self.direction else self.input_name

    def list_slots(self, model: MechanicalModel) -> list[tuple[Direction, np.ndarray]]:
        """Directions in which a force acts, each with the covector (d,) of the motion that it sees."""
        assert self.direction is not None
        if not (isinstance(self.effect, ForceEffect) and self.effect.crosswise):
            return [(self.direction, self.direction.covector)]
        first, second = np.eye(model.d)[
            [np.argmin(self.direction.covector), np.argmax(self.direction.covector)]
        ]
        inertia = np.sqrt((first @ model.inertia @ first) * (second @ model.inertia @ second))
        along = (Direction(None, covector, float(inertia)) for covector in (first, second))
        return list(zip(along, (second, -first), strict=True))

    def to_physical(self, x: Float64[np.ndarray, "P k"]) -> Float64[np.ndarray, "P k"]:
        """Parameters in the units of the recording, for unknowns ``x``."""
        counted = [(p, part.scales) for part in self.parts or (self,) for p in part.effect.parameters]
        columns = zip(counted, x.T, strict=True)
        return np.stack(
            [p.prior.value(column) * scales.of(p.kind) for (p, scales), column in columns], axis=1
        )

    def name_parameters(self, x: Float64[np.ndarray, " k"]) -> dict[str, float]:
        """Parameters by name, in the units of the recording and ratios as such, for unknowns ``x``."""
        values = self.to_physical(x[None])[0]
        return {
            p.name: float(np.exp(value) if p.kind == "log_ratio" else value)
            for p, value in zip(self.effect.parameters, values, strict=True)
        }


def drop_recorded_beginnings(
    effects: Sequence[PlacedEffect], x: Float64[np.ndarray, " k"]
) -> tuple[tuple[PlacedEffect, ...], Int64[np.ndarray, " n"]]:
    """The effects, each at a single place, without parameters that say where a memory began in a recording.

    With them come the places in ``x`` of the unknowns that are left; others than those of effects stay.
    """
    kept: list[PlacedEffect] = []
    index: list[int] = []
    at = 0
    for placed in (part for effect in effects for part in effect.parts or (effect,)):
        effect = placed.effect.with_free_memory(())
        index += range(at, at + len(effect.parameters))
        kept.append(replace(placed, effect=effect))
        at += placed.size
    return tuple(kept), np.array([*index, *range(at, len(x))], dtype=np.int64)


@dataclass(frozen=True)
class DisturbanceHints:
    """Where to look for disturbances of one coordinate, from the force that the simulation lacks."""

    pushes: tuple[tuple[float, float], ...]
    """Start and end [s] on the clock of the dataset, the strongest first."""
    lines_hz: tuple[float, ...]  # frequencies of the highest spectral lines
    stiffness_lines_hz: tuple[float, ...] = ()  # the same of the force times the distance from rest
    shaking: tuple[float, float] | None = None
    """Frequency [Hz] of the highest line of all coordinates together, and this one's signed share in it."""


@dataclass(frozen=True)
class PlaceFinder:
    """Finds the places of effects, from what matters for it of a mechanism and its recording."""

    coordinates: tuple[Direction, ...]
    pairs: tuple[Direction, ...]  # along the difference of each two coordinates; empty where there are many
    hints: tuple[DisturbanceHints, ...]  # one of each coordinate
    inputs: tuple[tuple[int, str, Scales], ...]  # channel, name and scales of each input that moves
    measure: Callable[[Direction, str], Scales]
    """Scales of the motion along a direction; the variants ``upper`` and ``lower`` look at one side alone."""
    whole: Scales  # scales of the coordinate that moves most
    longest_clips: tuple[int, ...]  # clips long enough to show where a memory began
    constant_inertia: bool
    targets: tuple[tuple[int, int, float], ...] = ()
    """Inputs that are position targets: input, coordinate, gain over the reference inertia [1/s^2]."""

    def find(self, effect: Effect) -> list[PlacedEffect]:
        """Every place that the effect itself names, or else its ``along`` and ``between_variants``."""
        if effect.memory_kinds:
            effect = effect.with_free_memory(self.longest_clips)
        if effect.place is not None:
            return effect.place(effect, self)
        placed: list[PlacedEffect] = []
        if isinstance(effect, InputEffect) and effect.along == "each":
            for channel, name, scales in self.inputs:
                placed.append(PlacedEffect(effect, scales, channel=channel, input_name=name))
            return _add_joint_placement(placed)
        if isinstance(effect, InputEffect) and not self.inputs:
            return placed
        # a force on the whole of one coordinate is the force along it
        single = isinstance(effect, ForceEffect) and len(self.coordinates) == 1
        for variant in effect.variants:
            if effect.along in ("each", "both"):
                placed += self.find_along_coordinates(effect, variant)
            if effect.along == "pairs" or variant in effect.between_variants:
                placed += self._find_along(effect, variant, self.pairs)
            both = effect.along == "both" and variant == effect.variants[0]
            if effect.along == "whole" or (both and not single):
                placed.append(PlacedEffect(effect, self.whole, variant))
        return placed

    def find_along_coordinates(self, effect: Effect, variant: str = "") -> list[PlacedEffect]:
        """The effect along each coordinate, and everywhere at once if it may act so."""
        return _add_joint_placement(self._find_along(effect, variant, self.coordinates))

    def find_along_controlled(self, effect: Effect) -> list[PlacedEffect]:
        """The effect along each coordinate; its law gets the gain of the position controller, and the rest.

        The gain is zero where no input is the coordinate's target.
        """
        gains = {i: gain for _, i, gain in self.targets}
        along = self._find_along(effect, "", self.coordinates)
        return [
            replace(placed, constants=(gains.get(i, 0.0), self.coordinates[i].rest))
            for i, placed in enumerate(along)
        ]

    def _find_along(
        self, effect: Effect, variant: str, directions: Sequence[Direction]
    ) -> list[PlacedEffect]:
        return [PlacedEffect(effect, self.measure(along, variant), variant, along) for along in directions]


def _add_joint_placement(places: list[PlacedEffect]) -> list[PlacedEffect]:
    """The places, and all of them where something moves at once, if the effect may act so.

    A parameter is then named after the place that it belongs to. The search begins with the same shape at
    every place.
    """
    moving = [placed for placed in places if placed.scales.reach > 0.0]
    if len(moving) < 2 or not moving[0].effect.acts_everywhere:
        return places
    effect, parameters = moving[0].effect, []
    for placed in moving:
        parameters += [replace(p, name=f"{p.name} {placed.location}") for p in effect.parameters]
    points = itertools.product(*(effect.parameters[i].grid for i in effect.shapes))
    grid = tuple(point * len(moving) for point in points)
    joint = replace(effect, parameters=tuple(parameters))
    everywhere = PlacedEffect(joint, moving[0].scales, moving[0].variant, grid=grid, parts=tuple(moving))
    return [*places, everywhere]
