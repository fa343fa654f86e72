"""The sim with the effects that a diagnosis added: one file that is simulated like any other sim.

The file, kind ``augmented``: the sim's coefficients, what a diagnosis moved of them, and of every effect its
name, place, sizes and fitted unknowns. Nothing in it is a program; laws are looked up by name.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.base import (
    Direction,
    ForceEffect,
    PlacedEffect,
    SampleEffect,
    make_direction,
)
from lagsplat.diagnose.effects.parameters import Scales
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.diagnose.estimation.dataset import OperatingRegion
from lagsplat.diagnose.estimation.nuisance import NuisanceParameters
from lagsplat.diagnose.estimation.rollout import RolloutModel
from lagsplat.diagnose.mechanics.basis import Basis
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.io.files.artifact import load_artifact, save_artifact

KIND, SCHEMA = "augmented", 1
FIELDS = ("mass", "damping", "potential", "input_map", "dry", "drag", "width", "rest")
BASIS = ("kind", "order", "centre", "scale")


@dataclass(frozen=True)
class AugmentedSimulator:
    """A sim, effects and their fitted unknowns ``x`` (k,), those of the effects followed by the sim's own."""

    model: MechanicalModel
    nuisance: NuisanceParameters
    effects: tuple[PlacedEffect, ...]
    x: Float64[np.ndarray, " k"]
    held: bool
    """Inputs are held between samples instead of interpolated."""
    step_s: float
    """Longest step of the integration [s]."""
    dt_s: float
    """Time between samples of the real recording [s]."""
    q_names: tuple[str, ...]
    u_names: tuple[str, ...]
    region: OperatingRegion
    """States and inputs of the real recording."""

    def parameters(self, n: int) -> dict[str, float]:
        """Parameters of effect number ``n`` in the units of the recording."""
        before = sum(len(e.effect.parameters) for e in self.effects[:n])
        effect = self.effects[n]
        return effect.name_parameters(self.x[before : before + len(effect.effect.parameters)])

    @property
    def bounded(self) -> bool:
        """Whether no effect feeds energy, so that a bounded push has a bounded response."""
        return all(
            placed.effect.keeps_energy_bounded(self.parameters(n), placed)
            for n, placed in enumerate(self.effects)
        )


def wrap_without_effects(
    model: MechanicalModel,
    *,
    held: bool,
    step_s: float,
    dt_s: float,
    q_names: Sequence[str],
    u_names: Sequence[str],
    region: OperatingRegion,
) -> AugmentedSimulator:
    """A sim to which nothing was added yet."""
    nothing = NuisanceParameters(1.0, 1.0, 1.0, np.ones(model.d), 1.0, model.n_u, np.zeros((0, _size(model))))
    x = np.zeros(nothing.size)
    return AugmentedSimulator(
        model, nothing, (), x, held, step_s, dt_s, tuple(q_names), tuple(u_names), region
    )


def build_augmented(
    bench: RolloutModel,
    effects: Sequence[PlacedEffect],
    x: Float64[np.ndarray, " k"],
    *,
    q_names: Sequence[str],
    u_names: Sequence[str],
    region: OperatingRegion,
) -> AugmentedSimulator:
    """What a fit on a bench found, ``x`` being its unknowns: the effects' own, then the uncertainties'.

    Effects that only widen the noise move nothing, have no unknowns in ``x`` and are left out; so is where
    the memory of others began in the recording.
    """
    moving, kept, at = [], [], 0
    for one in (p for e in effects if not isinstance(e.effect, SampleEffect) for p in e.parts or (e,)):
        size = len(one.effect.parameters)
        effect = one.effect.with_free_memory(()) if isinstance(one.effect, ForceEffect) else one.effect
        kept += list(range(at, at + len(effect.parameters)))
        moving.append(replace(one, effect=effect))
        at += size
    x = np.asarray(x, dtype=np.float64)
    x = x[[*kept, *range(at, len(x))]]
    step_s = bench.dataset.dt_s / bench.steps
    return AugmentedSimulator(
        bench.model, bench.nuisance, tuple(moving), x, bench.held,
        step_s, bench.dataset.dt_s, tuple(q_names), tuple(u_names), region,
    )  # fmt: skip


def transfer_effects(one: AugmentedSimulator, model: MechanicalModel) -> AugmentedSimulator:
    """The effects of ``one`` on another sim of the same coordinates and inputs, whose own parameters stay.

    Raises:
        ValueError: the sim has another number of coordinates or inputs.
    """
    if (model.d, model.n_u) != (one.model.d, one.model.n_u):
        raise ValueError(
            f"the effects were found on {one.model.d} coordinate(s) and {one.model.n_u} input(s), but this "
            f"sim has {model.d} and {model.n_u}; give the sim of that diagnosis, or a version of it"
        )
    spare = replace(one.nuisance, directions=np.zeros((0, _size(model))))
    own = sum(len(e.effect.parameters) for e in one.effects)
    effects = tuple(replace(e, direction=_moved(e.direction, model)) for e in one.effects)
    x = np.concatenate([one.x[:own], np.zeros(spare.size)])
    return replace(one, model=model, nuisance=spare, effects=effects, x=x)


def save_augmented(path: str | os.PathLike[str], one: AugmentedSimulator, header: Mapping[str, Any]) -> None:
    """Write an augmented sim; ``header`` says how it was made."""
    tensors: dict[str, np.ndarray] = {name: getattr(one.model, name) for name in FIELDS}
    tensors |= {f"basis.{name}": getattr(one.model.basis, name) for name in BASIS}
    tensors |= {f"region.{name}": getattr(one.region, name) for name in ("q", "v", "u")}
    tensors |= {"directions": one.nuisance.directions, "offset": one.nuisance.offset, "x": one.x}
    own = one.nuisance
    settings = {
        "nuisance": {name: getattr(own, name) for name in ("potential", "damping", "inputs", "warp", "n_u")},
        "effects": [
            {**_written(effect), "parameters": one.parameters(n)} for n, effect in enumerate(one.effects)
        ],
        "held": one.held,
        "step_s": one.step_s,
        "dt_s": one.dt_s,
        "q_names": list(one.q_names),
        "u_names": list(one.u_names),
    }
    save_artifact(
        path,
        tensors,
        {**header, "kind": KIND, "schema": SCHEMA, "bounded": one.bounded, "augmented": settings},
    )


def load_augmented(path: str | os.PathLike[str]) -> AugmentedSimulator:
    """Read an augmented sim.

    Raises:
        FileNotFoundError: nothing is at ``path``.
        ValueError: it is something else, of another schema, or names an effect that is not in the catalogue.
    """
    tensors, header = load_artifact(path, kind=KIND, schema=SCHEMA)
    said = header["augmented"]
    basis = Basis(**{name: tensors[f"basis.{name}"] for name in BASIS})
    return AugmentedSimulator(
        model=MechanicalModel(basis, **{name: tensors[name] for name in FIELDS}),
        nuisance=NuisanceParameters(
            **said["nuisance"], offset=tensors["offset"], directions=tensors["directions"]
        ),
        effects=tuple(_read(entry, path) for entry in said["effects"]),
        x=tensors["x"],
        held=said["held"],
        step_s=said["step_s"],
        dt_s=said["dt_s"],
        q_names=tuple(said["q_names"]),
        u_names=tuple(said["u_names"]),
        region=OperatingRegion(*(tensors[f"region.{name}"] for name in ("q", "v", "u"))),
    )


def _written(effect: PlacedEffect) -> dict[str, Any]:
    return {
        "name": effect.effect.name,
        "variant": effect.variant,
        "channel": effect.channel,
        "input_name": effect.input_name,
        "scales": asdict(effect.scales),
        "direction": None if effect.direction is None else asdict(effect.direction),
    }


def _read(entry: Mapping[str, Any], path: str | os.PathLike[str]) -> PlacedEffect:
    known = catalogue()
    if entry["name"] not in known:
        raise ValueError(
            f"{path}: effect {entry['name']!r} is not in the catalogue {sorted(known)}; use the version that "
            "made the file"
        )
    along = entry["direction"]
    direction = along and Direction(**{**along, "covector": np.array(along["covector"], dtype=np.float64)})
    return PlacedEffect(
        known[entry["name"]], Scales(**entry["scales"]), entry["variant"], direction or None,
        entry["channel"], entry["input_name"],
    )  # fmt: skip


def _moved(direction: Direction | None, model: MechanicalModel) -> Direction | None:
    return None if direction is None else make_direction(direction.name, direction.covector, model)


def _size(model: MechanicalModel) -> int:
    return sum(getattr(model, name).size for name in FIELDS[:6])
