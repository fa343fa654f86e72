"""Other methods on a cart whose change is known beforehand, and what they cannot say."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.gap_baselines.predict import METHODS, main
from benchmarks.gap_baselines.said import names
from benchmarks.gapgen.predictions import read_prediction
from lagsplat.report.diagnosis.serialization import check_diagnosis
from tests.unit.benchmarks.cases import move, recording

CHANGES: dict[str, dict[str, Any]] = {
    "viscous_damping": {"rate": 1.5},
    "coulomb_friction": {"extra": lambda q, v: -0.8 * np.tanh(v / 0.01)},
    "linear_stiffness": {"stiffness": 44.0},
    "none": {},
}
pytestmark = [pytest.mark.slow, pytest.mark.campaign]

FITTING = [name for name in METHODS if name != "chance"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of each change."""
    place = tmp_path_factory.mktemp("cases")
    for name, change in CHANGES.items():
        recording(place / name, move(**change))
    return place


@pytest.fixture(scope="module")
def said(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What every method says of every recording."""
    out = tmp_path_factory.mktemp("said")
    for method in METHODS:
        main(["--method", method, "--out", str(out / method), *(str(folder / name) for name in CHANGES)])
    return out


def read(place: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((place / "diagnosis.json").read_text(encoding="utf-8"))
    return found


@pytest.mark.parametrize("method", METHODS)
def test_every_prediction_has_the_form_of_a_diagnosis(said: Path, method: str) -> None:
    for name in CHANGES:
        document = read(said / method / name)
        check_diagnosis(document)
        prediction = read_prediction(said / method / name, [1.0])
        assert set(prediction.probability) == {*names(), "none", "unknown"}


@pytest.mark.parametrize("method", FITTING)
@pytest.mark.parametrize("name", [name for name in CHANGES if name != "none"])
def test_what_a_method_can_express_it_names(said: Path, method: str, name: str) -> None:
    document = read(said / method / name)
    assert document["effects"][0]["name"] == name
    assert document["effects"][0]["coordinate"] in ("q0", None)


@pytest.mark.parametrize("method", FITTING)
def test_nothing_is_named_where_nothing_changed(said: Path, method: str) -> None:
    assert read(said / method / "none")["verdict"] in ("none", "unknown")


@pytest.mark.parametrize("method", ["ensemble_sindy", "mujoco_sysid"])
def test_the_parameter_is_the_change_that_was_made(said: Path, method: str) -> None:
    found = read(said / method / "viscous_damping")["effects"][0]["parameters"]["rate"]
    assert found["value"] == pytest.approx(1.2, rel=0.25)
    assert found["low"] < found["value"] < found["high"]


@pytest.mark.parametrize("method", FITTING)
def test_a_named_effect_closes_the_gap_of_the_held_out_half(said: Path, method: str) -> None:
    prediction = read_prediction(said / method / "coulomb_friction", [1.0])
    assert prediction.gaps is not None
    assert prediction.gaps[1] < 0.4 * prediction.gaps[0]


@pytest.mark.parametrize("method", ["chance", "discrepancy_test", "ensemble_sindy"])
def test_a_prediction_depends_on_the_content_alone(
    folder: Path, said: Path, tmp_path: Path, method: str
) -> None:
    other = tmp_path / "renamed"
    shutil.copytree(folder / "linear_stiffness", other, copy_function=shutil.copyfile)
    main(["--method", method, "--out", str(tmp_path / "said"), str(folder / "none"), str(other)])
    assert read(tmp_path / "said" / "renamed") == read(said / method / "linear_stiffness")
