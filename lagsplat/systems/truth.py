"""The truth behind a simulated recording, in a file of its own that training never opens."""

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

from lagsplat.io.files.artifact import load_artifact, save_artifact
from lagsplat.systems.arm import Arm
from lagsplat.systems.dynamics import Series, Vector, VibrationModes
from lagsplat.systems.mechanism import Mechanism

KIND = "truth"
SCHEMA = 2
MASS_STRIDE_FRAMES = 20


@dataclass(frozen=True)
class Truth:
    """States at the frames, quantities from the system's equations, and its `VibrationModes` at rest."""

    coordinates: tuple[str, ...]  # name and unit of each column of the states
    states: Float64[np.ndarray, "T d"]
    velocities: Float64[np.ndarray, "T d"]  # the same per second
    pressures: Float64[np.ndarray, "T n_u"]  # without noise [atm]; no column without chambers
    forces: Float64[np.ndarray, "T d"]  # external generalised forces
    kinetic_energy: Float64[np.ndarray, " T"]  # [J]
    potential_energy: Float64[np.ndarray, " T"]  # [J]
    mass_frames: Int64[np.ndarray, " S"]  # frames of the mass matrices
    mass_matrices: Float64[np.ndarray, "S d d"]
    rest: Float64[np.ndarray, " d"]
    natural_frequencies_hz: Float64[np.ndarray, " n_modes"]
    damped_frequencies_hz: Float64[np.ndarray, " n_modes"]
    decay_rates_per_s: Float64[np.ndarray, " n_modes"]
    damping_ratios: Float64[np.ndarray, " n_modes"]
    # about the rest state under the mean pressure; empty without chambers
    mean_pressure: Float64[np.ndarray, " n_u"] = field(default_factory=lambda: np.zeros(0))
    loaded_frequencies_hz: Float64[np.ndarray, " n_modes"] = field(default_factory=lambda: np.zeros(0))
    loaded_decay_rates_per_s: Float64[np.ndarray, " n_modes"] = field(default_factory=lambda: np.zeros(0))


def compute_truth(
    system: Arm | Mechanism,
    states: Series,
    velocities: Series,
    *,
    pressures: Float64[np.ndarray, "T n_u"],
    forces: Series,
    rest: Vector,
    modes: VibrationModes,
) -> Truth:
    """Evaluate the equations of ``system`` along a trajectory; see `Truth` for the arguments."""
    frames = np.arange(0, len(states), MASS_STRIDE_FRAMES)
    loaded = {}
    if isinstance(system, Arm):
        mean = pressures.mean(axis=0)
        held = system.modes(mean)
        loaded = {
            "mean_pressure": mean,
            "loaded_frequencies_hz": held.damped_hz,
            "loaded_decay_rates_per_s": held.decay_per_s,
        }
    kinetic = [0.5 * v @ system.mass(q) @ v for q, v in zip(states, velocities, strict=True)]
    return Truth(
        coordinates=system.coordinates,
        states=states,
        velocities=velocities,
        pressures=pressures,
        forces=forces,
        kinetic_energy=np.array(kinetic),
        potential_energy=system.potential_energies(states),
        mass_frames=frames,
        mass_matrices=np.stack([system.mass(q) for q in states[frames]]),
        rest=rest,
        natural_frequencies_hz=modes.natural_hz,
        damped_frequencies_hz=modes.damped_hz,
        decay_rates_per_s=modes.decay_per_s,
        damping_ratios=modes.damping_ratio,
        **loaded,
    )


def save_truth(path: str | os.PathLike[str], truth: Truth, header: Mapping[str, Any]) -> None:
    """Write ``truth`` to ``path`` as an artefact of kind ``truth``, with the configuration in ``header``."""
    tensors = asdict(truth)
    names = {"coordinates": tensors.pop("coordinates")}
    save_artifact(path, tensors, {**header, **names, "kind": KIND, "schema": SCHEMA})


def load_truth(path: str | os.PathLike[str]) -> tuple[Truth, dict[str, Any]]:
    """Read the truth at ``path`` and its header; errors as `load_artifact`."""
    tensors, header = load_artifact(path, kind=KIND, schema=SCHEMA)
    return Truth(coordinates=tuple(header["coordinates"]), **tensors), header
