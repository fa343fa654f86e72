"""Copies of the datasets that LeRobot's own writer made (`make_data`), which a test may spoil."""

import shutil
from pathlib import Path

import pytest

DATA = Path(__file__).parent / "data"


@pytest.fixture(params=["v21", "v30"])
def dataset(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    return Path(shutil.copytree(DATA / request.param, tmp_path / request.param))


@pytest.fixture
def v21(tmp_path: Path) -> Path:
    return Path(shutil.copytree(DATA / "v21", tmp_path / "v21"))


@pytest.fixture
def v30(tmp_path: Path) -> Path:
    return Path(shutil.copytree(DATA / "v30", tmp_path / "v30"))
