from dataclasses import replace
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from lagsplat.stage2.config import FloorConfig, SelectConfig, ShootConfig, StartConfig
from tests.stage2_problems import form


def test_a_value_outside_its_domain_is_named_with_its_choices() -> None:
    with pytest.raises(ValueError, match=r"stage2\.form\.mass=heavy is none of learned, constant, induced"):
        replace(form(), mass="heavy")
    with pytest.raises(ValueError, match=r"diffeo_lipschitz=1\.0"):
        replace(form(), diffeo_lipschitz=1.0)
    with pytest.raises(ValueError, match=r"stage2\.floor\.damping=0\.0"):
        FloorConfig(1e-2, 0.0, 1e-2)
    with pytest.raises(ValueError, match=r"stage2\.start\.source=random"):
        StartConfig("random", 1, 0, "data", 0.2, 1.0)
    with pytest.raises(ValueError, match=r"stage2\.shoot\.steps=-1"):
        ShootConfig(-1, 1, 1e-3, 1.0, 0.0)
    with pytest.raises(ValueError, match=r"stage2\.shoot\.anchor=-1"):
        ShootConfig(1, 1, 1e-3, 1.0, -1.0)
    with pytest.raises(ValueError, match=r"stage2\.select\.starts"):
        SelectConfig(0, 1.0, 1)


def test_every_file_of_the_group_inherits_the_default(repository: Path) -> None:
    for path in (repository / "conf" / "stage2").glob("*.yaml"):
        keys = set(OmegaConf.load(path)) - {"defaults"}
        assert keys <= set(OmegaConf.load(repository / "conf" / "stage2" / "default.yaml")), path.name
