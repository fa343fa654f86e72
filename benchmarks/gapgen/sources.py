"""Who computes a recording's motion: the generator's own equations, MuJoCo, equations of textbooks, or those
that are held back from calibrations."""

import numpy as np
from numpy.typing import NDArray

from benchmarks.gapgen.bases import base_pull
from benchmarks.gapgen.effect import Effect
from benchmarks.gapgen.mechanisms import Mechanism, draw_mechanism
from benchmarks.gapgen.motion import World
from benchmarks.gapgen.mujoco_world import MUJOCO, MujocoMechanism, MujocoWorld, draw_mujoco
from benchmarks.gapgen.payloads import with_payload

Array = NDArray[np.float64]

TEXTBOOK = ("cart_pole", "acrobot", "furuta")
HELD_BACK = ("ship_roll", "bead_on_hoop", "elastic_joint", "quarter_car", "rotational_actuator")
SOURCES = ("own", "mujoco", "textbook", "held_back")


def source_of(system: str) -> str:
    """The source of physics of a system by its name."""
    others = {"mujoco": MUJOCO, "textbook": TEXTBOOK, "held_back": HELD_BACK}
    return next((source for source, systems in others.items() if system in systems), "own")


def draw_any(system: str, rng: np.random.Generator) -> Mechanism:
    """A nominal mechanism of the named system, from whichever source.

    Raises:
        ValueError: if no such system exists.
    """
    return draw_mujoco(system, rng) if system in MUJOCO else draw_mechanism(system, rng)


def payload_kg(m: Mechanism) -> Array:
    """Mass [kg] whose addition doubles the inertia of a coordinate at rest, (d,); zero but of the first."""
    kg, inertia = np.zeros(m.d), m.inertia_at_rest()[0, 0]
    loaded = (
        m.loaded_inertia() if isinstance(m, MujocoMechanism) else with_payload(m, 0, 1.0).inertia_at_rest()
    )
    kg[0] = inertia / (loaded[0, 0] - inertia)
    return kg


def base_reach(m: Mechanism) -> float:
    """Acceleration of the base by which the first coordinate is accelerated by one, at rest."""
    if isinstance(m, MujocoMechanism):
        return float(m.inertia_at_rest()[0, 0] / m.base_pull()[0])
    pull = np.zeros(m.d)
    base_pull(m.kind, m.p, np.zeros(m.d), m.inertia_at_rest(), pull)
    return float(m.inertia_at_rest()[0, 0] / pull[0])


def world_of(m: Mechanism, effects: list[Effect] | None = None) -> World:
    """The world that moves a mechanism with its effects."""
    kind = MujocoWorld if isinstance(m, MujocoMechanism) else World
    return kind(m, effects or [])
