"""The seven simulated systems with other numbers, drawn at random: recordings that nothing was set on.

Constants of the method were chosen while looking at the recordings of ``conf/release`` and
``conf/simulation``. `draw_overrides` changes what a mechanism is: size (with its camera), mass, friction or
stiffness, how far and to which side it is let go, the wall behind it, and the band of an arm's drive. Factors
are drawn log-uniformly between 1 / `SPREAD` and `SPREAD`. ``python -m benchmarks.drawn_systems 1`` shows one.
"""

import sys
from operator import attrgetter
from typing import Any

import numpy as np

from lagsplat.config.compose import compose
from lagsplat.systems.config import ReleaseConfig, SimulationConfig
from lagsplat.systems.rendering.workshop import WALLS

RELEASED = ("pendulum", "rainbow_rocker", "rocking_chair", "hanging_bag", "double_pendulum")
DRIVEN = ("krauss_1seg", "krauss_2seg")
# Set before any run, by what keeps a picture alike: an arm that is heavier or softer would leave it.
SPREAD = {"size": 1.4, "mass": 1.4, "friction": 2.0, "stiffness": 1.2, "drive": 1.2}
LEAST_RELEASE = 0.6  # of the angle and speed of a release; above 1 some would leave the picture


def draw_overrides(number: int) -> dict[str, str]:
    """Overrides of each system, by its name, for the draw ``number``."""
    overrides = {}
    for place, system in enumerate((*RELEASED, *DRIVEN)):
        rng = np.random.default_rng([number, place])
        config = compose(f"system={system}")
        if config.release is not None:
            changed = change_release(config.release, rng)
        elif config.simulation is not None:
            changed = change_simulation(config.simulation, rng)
        else:
            raise ValueError(f"{system} is not simulated")
        overrides[system] = " ".join(f"{name}={_write(value)}" for name, value in changed.items())
    return overrides


def change_release(release: ReleaseConfig, rng: np.random.Generator) -> dict[str, Any]:
    """Changed settings of a mechanism that is let go: its picture looks alike, its motion does not."""
    size, mass, friction = (draw_factor(rng, name) for name in ("size", "mass", "friction"))
    amplitude = rng.uniform(LEAST_RELEASE, 1.0) * rng.choice([-1.0, 1.0])
    inertia = mass * size**2
    in_scene = ("background_width", "behind", "target", "distance", "view_width")
    factors = {f"scene.{name}": size for name in in_scene}
    if release.linkage is not None:
        factors |= {
            **dict.fromkeys(("linkage.length", "linkage.center"), size),
            **{"linkage.masses": mass, "linkage.spring": mass * size},
            **{"linkage.inertia": inertia, "linkage.friction": inertia * friction},
        }
    else:
        factors |= {
            **dict.fromkeys(("rocker.radius", "rocker.depth"), size),
            "rocker.body_mass": mass,
            **{"rocker.inertia": inertia, "rocker.friction": inertia * friction},
        }
    bodies = [
        {**vars(body), "size_m": scale(body.size_m, size), "thickness_m": scale(body.thickness_m, size)}
        for body in release.bodies
    ]
    clips = [
        {**vars(clip), **{name: scale(getattr(clip, name), amplitude) for name in ("state", "velocity")}}
        for clip in release.clips
    ]
    changed = {name: scale(attrgetter(name)(release), by) for name, by in factors.items()}
    changed |= {"bodies": bodies, "clips": clips, "scene.background": str(rng.choice(sorted(WALLS)))}
    return {f"release.{name}": value for name, value in changed.items()}


def change_simulation(simulation: SimulationConfig, rng: np.random.Generator) -> dict[str, Any]:
    """Changed settings of an arm; chambers grow with its stiffness, so that it moves about as far."""
    mass, stiffness, damping, drive = (
        draw_factor(rng, kind) for kind in ("stiffness", "stiffness", "friction", "drive")
    )
    factors = {
        **dict.fromkeys(("arm.mass", "arm.link_mass"), mass),
        **dict.fromkeys(("arm.bending_stiffness", "arm.extension_stiffness", "arm.chamber_area"), stiffness),
        **{"arm.retardation_s": damping, "drive_high_hz": drive},
    }
    return {f"simulation.{name}": scale(attrgetter(name)(simulation), by) for name, by in factors.items()}


def draw_factor(rng: np.random.Generator, kind: str) -> float:
    """A factor between 1 / `SPREAD` and `SPREAD`, log-uniform."""
    return float(SPREAD[kind] ** rng.uniform(-1.0, 1.0))


def scale(value: Any, by: float) -> Any:
    """A number, or every number of a list, times ``by``, to five digits."""
    if isinstance(value, list):
        return [scale(each, by) for each in value]
    return float(f"{value * by:.5g}")


def _write(value: Any) -> str:
    """A value as Hydra reads it, without spaces."""
    if isinstance(value, dict):
        return "{" + ",".join(f"{key}:{_write(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ",".join(map(_write, value)) + "]"
    return str(value)


if __name__ == "__main__":
    for name, words in draw_overrides(int(sys.argv[1])).items():
        print(f'hydra_{name}="{words}"')
