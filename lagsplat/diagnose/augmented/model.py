"""A simulator with the effects that a diagnosis added, in one file that runs like any other simulator.

The file, an artifact of kind ``augmented``, holds the coefficients of the model, the fitted nuisance
parameters, and of every effect its name, place, scales and fitted unknowns. It holds no code: laws are looked
up in the catalogue by name.
"""

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.base import Direction, PlacedEffect, drop_recorded_beginnings
from lagsplat.diagnose.effects.parameters import Scales
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.diagnose.estimation.dataset import OperatingRegion
from lagsplat.diagnose.estimation.nuisance import NuisanceParameters
from lagsplat.diagnose.estimation.rollout import RolloutModel
from lagsplat.diagnose.mechanics.basis import Basis
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.mechanics.structure import COEFFICIENT_FIELDS, flatten_coefficients
from lagsplat.io.files.artifact import load_artifact, save_artifact

KIND, SCHEMA = "augmented", 4
FIELDS = (*COEFFICIENT_FIELDS, "width", "rest")
BASIS = ("kind", "order", "centre", "scale")
REGION = ("q", "v", "u")
NUISANCE = ("potential", "damping", "inputs", "inertia", "warp", "n_u")
PLACE = ("variant", "channel", "input_name", "constants", "spared")
SAMPLING = ("held", "step_s", "dt_s", "q_names", "u_names")


@dataclass(frozen=True)
class AugmentedSimulator:
    """A mechanical model with effects and their fitted unknowns."""

    model: MechanicalModel
    nuisance: NuisanceParameters  # what a fit may change of the model itself
    effects: tuple[PlacedEffect, ...]
    x: Float64[np.ndarray, " k"]
    """Unknowns of the effects, one after the other, followed by the nuisance parameters."""
    held: bool  # inputs are held between samples instead of interpolated
    step_s: float  # longest step of the integration [s]
    dt_s: float  # time between samples of the real recording [s]
    q_names: tuple[str, ...]
    u_names: tuple[str, ...]
    region: OperatingRegion  # states and inputs of the real recording

    def split_unknowns(self) -> list[Float64[np.ndarray, " n"]]:
        """The unknowns of each effect, and last the nuisance parameters."""
        return np.split(self.x, np.cumsum([placed.size for placed in self.effects], dtype=np.int64))

    def parameters(self, n: int) -> dict[str, float]:
        """Parameters of effect number ``n`` in the units of the recording."""
        return self.effects[n].name_parameters(self.split_unknowns()[n])


def build_augmented(
    rollout_model: RolloutModel,
    effects: Sequence[PlacedEffect],
    x: Float64[np.ndarray, " k"],
    *,
    q_names: Sequence[str],
    u_names: Sequence[str],
    region: OperatingRegion,
) -> AugmentedSimulator:
    """The simulator that a fit describes; ``x`` are its unknowns, those of the nuisance parameters last.

    Effects of single samples move nothing, have no unknowns here and are left out. So are the unknowns that
    say where a memory began in the recording. ``region`` is that of the real recording.
    """
    x = np.asarray(x, dtype=np.float64)
    moving, kept = drop_recorded_beginnings([placed for placed in effects if placed.changes_motion], x)
    return AugmentedSimulator(
        model=rollout_model.model,
        nuisance=rollout_model.nuisance,
        effects=moving,
        x=x[kept],
        held=rollout_model.held,
        step_s=rollout_model.dataset.dt_s / rollout_model.steps,
        dt_s=rollout_model.dataset.dt_s,
        q_names=tuple(q_names),
        u_names=tuple(u_names),
        region=region,
    )


def transfer_effects(simulator: AugmentedSimulator, model: MechanicalModel) -> AugmentedSimulator:
    """The effects of a simulator on another model of the same coordinates and inputs, which stays as it is.

    Raises:
        ValueError: the model has another number of coordinates or inputs.
    """
    if (model.d, model.n_u) != (simulator.model.d, simulator.model.n_u):
        raise ValueError(
            f"the effects were found on {simulator.model.d} coordinate(s) and {simulator.model.n_u} "
            f"input(s), but this sim has {model.d} and {model.n_u}; give the sim of that diagnosis, or a "
            "version of it"
        )
    nuisance = replace(simulator.nuisance, directions=np.zeros((0, flatten_coefficients(model).size)))
    effects = []
    for placed in simulator.effects:
        along = placed.direction and Direction.of(placed.direction.name, placed.direction.covector, model)
        effects.append(replace(placed, direction=along))
    x = np.concatenate([*simulator.split_unknowns()[:-1], np.zeros(nuisance.size)])
    return replace(simulator, model=model, nuisance=nuisance, effects=tuple(effects), x=x)


def save_augmented(
    path: str | os.PathLike[str], simulator: AugmentedSimulator, header: Mapping[str, Any]
) -> None:
    """Write an augmented simulator; ``header`` says how it was made."""
    nuisance = simulator.nuisance
    tensors: dict[str, np.ndarray] = {name: getattr(simulator.model, name) for name in FIELDS}
    tensors |= {f"basis.{name}": getattr(simulator.model.basis, name) for name in BASIS}
    tensors |= {f"region.{name}": getattr(simulator.region, name) for name in REGION}
    tensors |= {"directions": nuisance.directions, "offset": nuisance.offset, "x": simulator.x}
    effects = []
    for n, placed in enumerate(simulator.effects):
        entry: dict[str, Any] = {"name": placed.effect.name}
        entry |= {name: getattr(placed, name) for name in PLACE}
        entry["scales"] = asdict(placed.scales)
        entry["direction"] = placed.direction and asdict(placed.direction)
        effects.append({**entry, "parameters": simulator.parameters(n)})
    settings = {
        "nuisance": {name: getattr(nuisance, name) for name in NUISANCE},
        "effects": effects,
        **{name: getattr(simulator, name) for name in SAMPLING},
    }
    made = {"kind": KIND, "schema": SCHEMA, "augmented": settings}
    save_artifact(path, tensors, {**header, **made})


def load_augmented(path: str | os.PathLike[str]) -> AugmentedSimulator:
    """Read an augmented simulator.

    Raises:
        FileNotFoundError: nothing is at ``path``.
        ValueError: it is something else, of another schema, or names an effect that is not in the catalogue.
    """
    tensors, header = load_artifact(path, kind=KIND, schema=SCHEMA)
    settings = header["augmented"]
    basis = Basis(**{name: tensors[f"basis.{name}"] for name in BASIS})
    return AugmentedSimulator(
        model=MechanicalModel(basis, **{name: tensors[name] for name in FIELDS}),
        nuisance=NuisanceParameters(
            **settings["nuisance"], offset=tensors["offset"], directions=tensors["directions"]
        ),
        effects=tuple(_restore_effect(entry, path) for entry in settings["effects"]),
        x=tensors["x"],
        region=OperatingRegion(*(tensors[f"region.{name}"] for name in REGION)),
        **{name: settings[name] for name in ("held", "step_s", "dt_s")},
        q_names=tuple(settings["q_names"]),
        u_names=tuple(settings["u_names"]),
    )


def _restore_effect(entry: Mapping[str, Any], path: str | os.PathLike[str]) -> PlacedEffect:
    known = catalogue()
    if entry["name"] not in known:
        raise ValueError(
            f"{path}: effect {entry['name']!r} is not in the catalogue {sorted(known)}; use the version that "
            "made the file, or register the effect before"
        )
    along = entry["direction"]
    direction = along and Direction(**{**along, "covector": np.array(along["covector"], dtype=np.float64)})
    where = {name: entry[name] for name in PLACE}
    where |= {name: tuple(where[name]) for name in ("constants", "spared")}
    return PlacedEffect(known[entry["name"]], Scales(**entry["scales"]), direction=direction or None, **where)
