"""Which systems are planned in space, and what behind a rig's JSON a plan depends on."""

import json
from pathlib import Path

import pytest

from lagsplat.config.compose import ConfigError
from lagsplat.planning.plan import Overrides, files_of_rig, planned_spatial
from tests.unit.views.test_rig import RIG, written


def plan(*shared: str, **of_system: tuple[str, ...]):
    return planned_spatial(Overrides(shared, of_system))


def test_the_rocker_is_planned_in_space_with_its_first_seeds() -> None:
    runs = plan("seeds=[3,4]")
    assert list(runs) == ["rocker"]
    assert (runs["rocker"].system, runs["rocker"].seed) == ("rainbow_rocker_3d", 3)


def test_who_chooses_systems_or_films_gets_no_simulated_rocker() -> None:
    assert plan("systems=[pendulum]") == {}
    assert list(plan("systems=[pendulum]", "spatial=[rainbow_rocker_3d]")) == ["rocker"]
    assert plan("systems=[pendulum]", "recording=filmed", "recording.path=film.mp4") == {}


def test_a_system_of_the_picture_cannot_be_pushed_in_space() -> None:
    with pytest.raises(ConfigError, match="pendulum has no novel views"):
        plan("spatial=[pendulum]")
    assert list(plan("spatial=[pendulum]", pendulum=("views=simulated",))) == ["pendulum"]


def test_a_plan_depends_on_the_films_of_a_rig(tmp_path: Path) -> None:
    rig = written(tmp_path, RIG)
    assert files_of_rig(str(rig)) == [str(rig), str(tmp_path / "left.mp4")]
    rig.write_text(json.dumps({}))
    with pytest.raises(ConfigError, match=r"views\.rig=.*not a rig of version 1"):
        files_of_rig(str(rig))
