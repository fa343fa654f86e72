"""The truth behind a simulated recording, kept in a file of its own that training never opens."""

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

from lagsplat.io.artefact import load_artefact, save_artefact
from lagsplat.systems.arm import Arm

KIND = "truth"
SCHEMA = 1


@dataclass(frozen=True)
class Truth:
    """States of the arm at the frames, and what its equations say about them.

    ``states`` are ``(theta_1 [rad], eps_1, ...)``, ``velocities`` the same per second, ``pressures`` [atm]
    free of noise, energies [J], ``mass_matrices`` those of the frames ``mass_frames``. Free modes linearised
    about ``rest``, slowest first: ``damped_frequencies_hz`` is what a decaying record shows,
    ``natural_frequencies_hz`` the modulus of the eigenvalue over 2 pi, ``decay_rates_per_s`` the rate of the
    envelope.
    """

    states: Float64[np.ndarray, "T d"]
    velocities: Float64[np.ndarray, "T d"]
    pressures: Float64[np.ndarray, "T n_u"]
    kinetic_energy: Float64[np.ndarray, " T"]
    potential_energy: Float64[np.ndarray, " T"]
    mass_frames: Int64[np.ndarray, " S"]
    mass_matrices: Float64[np.ndarray, "S d d"]
    rest: Float64[np.ndarray, " d"]
    natural_frequencies_hz: Float64[np.ndarray, " n_modes"]
    damped_frequencies_hz: Float64[np.ndarray, " n_modes"]
    decay_rates_per_s: Float64[np.ndarray, " n_modes"]
    damping_ratios: Float64[np.ndarray, " n_modes"]


def truth_of(
    arm: Arm,
    states: Float64[np.ndarray, "T d"],
    velocities: Float64[np.ndarray, "T d"],
    pressures: Float64[np.ndarray, "T n_u"],
    *,
    mass_stride_frames: int,
) -> Truth:
    """All that the arm's equations say of this trajectory; mass matrices every ``mass_stride_frames``."""
    modes = arm.modes()
    frames = np.arange(0, len(states), mass_stride_frames)
    return Truth(
        states=states,
        velocities=velocities,
        pressures=pressures,
        kinetic_energy=np.array([arm.kinetic_energy(q, v) for q, v in zip(states, velocities, strict=True)]),
        potential_energy=arm.potential_energies(states),
        mass_frames=frames,
        mass_matrices=np.stack([arm.mass(q) for q in states[frames]]),
        rest=arm.equilibrium(np.zeros(arm.d)),
        natural_frequencies_hz=modes.natural_hz,
        damped_frequencies_hz=modes.damped_hz,
        decay_rates_per_s=modes.decay_per_s,
        damping_ratios=modes.damping_ratio,
    )


def save_truth(path: str | os.PathLike[str], truth: Truth, header: Mapping[str, Any]) -> None:
    """Keep ``truth`` at ``path`` as an artefact of kind ``truth``, with the configuration in ``header``."""
    save_artefact(path, asdict(truth), {**header, "kind": KIND, "schema": SCHEMA})


def load_truth(path: str | os.PathLike[str]) -> tuple[Truth, dict[str, Any]]:
    """The truth kept at ``path``, and its header.

    Raises:
        FileNotFoundError, ValueError: as `load_artefact`.
    """
    tensors, header = load_artefact(path, kind=KIND, schema=SCHEMA)
    return Truth(**{field.name: tensors[field.name] for field in fields(Truth)}), header
