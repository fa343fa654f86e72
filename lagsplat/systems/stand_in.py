"""The simulated stand-in of a system, whichever kind it is."""

from dataclasses import replace

from lagsplat.io.recording import Recording
from lagsplat.systems.config import SimulationConfig
from lagsplat.systems.release import release
from lagsplat.systems.release_config import ReleaseConfig
from lagsplat.systems.simulate import simulate
from lagsplat.systems.truth import Truth


def stand_in(
    driven: SimulationConfig | None, released: ReleaseConfig | None, *, seed: int
) -> tuple[Recording, Truth]:
    """The recording of a driven arm or of a mechanism that is let go, and its truth.

    Raises:
        ValueError: neither is given, or as `simulate` and `release`.
    """
    if driven is not None:
        return simulate(driven, seed=seed)
    if released is not None:
        return release(released, seed=seed)
    raise ValueError("the system has neither a simulation nor a release; choose recording=filmed")


def resized(
    driven: SimulationConfig | None, released: ReleaseConfig | None, *, height: int, width: int
) -> tuple[SimulationConfig | None, ReleaseConfig | None]:
    """The same motion in frames of another size [pixel]; a film stays as large as it was, if it can."""
    if driven is not None:
        driven = replace(driven, height=height, width=width)
    if released is not None:
        scale = max(1, round(released.scene.film_scale * released.height / height))
        scene = replace(released.scene, film_scale=scale)
        released = replace(released, height=height, width=width, scene=scene)
    return driven, released
