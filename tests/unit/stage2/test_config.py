from dataclasses import replace
from pathlib import Path

import pytest
from omegaconf import OmegaConf

from lagsplat.stage2.config import FloorConfig, LikelihoodConfig, SelectConfig, StartConfig
from tests.stage2_problems import form
from tests.unit.stage2.test_fit import config


def test_a_value_outside_its_domain_is_named_with_its_choices() -> None:
    with pytest.raises(ValueError, match=r"stage2\.form\.mass=heavy is none of learned, constant, induced"):
        replace(form(), mass="heavy")
    with pytest.raises(ValueError, match=r"diffeo_lipschitz=1\.0"):
        replace(form(), diffeo_lipschitz=1.0)
    with pytest.raises(ValueError, match=r"stage2\.floor\.damping=0\.0"):
        FloorConfig(1e-2, 0.0, 1e-2)
    with pytest.raises(ValueError, match=r"stage2\.start\.source=random"):
        StartConfig("random", 1, "data", 0.2, 1.0)
    with pytest.raises(ValueError, match=r"stage2\.likelihood\.network_iterations=0"):
        LikelihoodConfig(600, 8, 1.3, 0)
    with pytest.raises(ValueError, match=r"stage2\.select\.starts"):
        SelectConfig(0, 1.0, 1)


def test_polynomials_have_one_estimator_and_one_integrator() -> None:
    polynomial = config(form=form(terms="polynomial"))
    with pytest.raises(ValueError, match=r"stage2\.start\.source=fitted is for networks"):
        replace(polynomial, start=replace(polynomial.start, source="fitted"))
    with pytest.raises(ValueError, match=r"stage2\.integrator=verlet is for networks"):
        replace(polynomial, integrator="verlet")


def test_every_file_of_the_group_inherits_the_default(repository: Path) -> None:
    for path in (repository / "conf" / "stage2").glob("*.yaml"):
        keys = set(OmegaConf.load(path)) - {"defaults"}
        assert keys <= set(OmegaConf.load(repository / "conf" / "stage2" / "default.yaml")), path.name
