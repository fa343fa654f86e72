"""Who computes a recording's motion: the generator's own equations, MuJoCo, or equations of textbooks."""

import numpy as np

from benchmarks.gapgen.effect import Effect
from benchmarks.gapgen.mechanisms import Mechanism, draw_mechanism
from benchmarks.gapgen.motion import World
from benchmarks.gapgen.mujoco_world import MUJOCO, MujocoMechanism, MujocoWorld, draw_mujoco

TEXTBOOK = ("cart_pole", "acrobot", "furuta")
SOURCES = ("own", "mujoco", "textbook")


def source_of(system: str) -> str:
    """The source of physics of a system by its name."""
    return "mujoco" if system in MUJOCO else "textbook" if system in TEXTBOOK else "own"


def draw_any(system: str, rng: np.random.Generator) -> Mechanism:
    """A nominal mechanism of the named system, from whichever source.

    Raises:
        ValueError: if no such system exists.
    """
    return draw_mujoco(system, rng) if system in MUJOCO else draw_mechanism(system, rng)


def world_of(m: Mechanism, effects: list[Effect] | None = None) -> World:
    """The world that moves a mechanism with its effects."""
    kind = MujocoWorld if isinstance(m, MujocoMechanism) else World
    return kind(m, effects or [])
