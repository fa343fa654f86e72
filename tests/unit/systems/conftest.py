"""The simulated arms as conf/simulation describes them."""

from collections.abc import Callable
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from lagsplat.systems.config import SimulationConfig


@pytest.fixture(scope="session")
def load(repository: Path) -> Callable[..., SimulationConfig]:
    """``load(name, **changes)``: a choice of conf/simulation with some values replaced."""

    def read(name: str, **changes: object) -> SimulationConfig:
        values = OmegaConf.load(repository / "conf" / "simulation" / f"{name}.yaml")
        return OmegaConf.to_object(OmegaConf.merge(OmegaConf.structured(SimulationConfig), values, changes))

    return read
