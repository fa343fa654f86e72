"""The simulated stand-in of a system, whichever kind it is."""

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
