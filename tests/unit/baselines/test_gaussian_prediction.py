"""The authors' tool, up to the launch and through it, with a small program in its place."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from omegaconf import OmegaConf

from lagsplat.baselines.config import AuthorsConfig
from lagsplat.baselines.gaussian_prediction import (
    SUBMODULES,
    check_checkout,
    check_cuda,
    make_forecast_command,
    make_train_command,
    predict_frames,
    run_tool,
)

CONF = Path(__file__).parents[3] / "conf" / "authors" / "default.yaml"
FRAMES = np.random.default_rng(0).integers(0, 256, size=(12, 6, 8, 3), dtype=np.uint8)

TRAIN = """
import json, pathlib, sys
from scene.dataset_readers import readScene
import argparse
parser = argparse.ArgumentParser()
for name in ("-s", "-m", "--max_time", "--iterations"):
    parser.add_argument(name, required=True)
given, _ = parser.parse_known_args()
radius = readScene(json.load(open(given.s + "/transforms_train.json"))["frames"])
if radius == 0:
    sys.exit("all Gaussians were removed")
model = pathlib.Path(given.m)
model.mkdir(parents=True)
story = {"radius": radius, "data": given.s, "max_time": given.max_time}
(model / "trained.json").write_text(json.dumps(story))
"""
READERS = """
def getNerfppNorm(cameras):
    first = cameras[0]["transform_matrix"]
    return {"translate": 0, "radius": 0.0 if all(c["transform_matrix"] == first for c in cameras) else 3.0}

def readScene(cameras):
    return getNerfppNorm(cameras)["radius"]
"""
FORECAST = """
import json, pathlib, shutil, sys
import argparse
parser = argparse.ArgumentParser()
for name in ("-m", "--max_time", "--exp_name", "--ckpt_iteration"):
    parser.add_argument(name, required=True)
parser.add_argument("--predict_more", action="store_true")
parser.add_argument("--frames", type=int, default=150)
given, _ = parser.parse_known_args()
model = pathlib.Path(given.m)
if "d-nerf" not in given.m:
    sys.exit("the wrong reader would be taken")
trained = json.loads((model / "trained.json").read_text())
assert trained["max_time"] == given.max_time
data = pathlib.Path(trained["data"])
listed = json.loads((data / "transforms_train.json").read_text())["frames"]
held = [f["file_path"] for f in listed if f["time"] >= float(given.max_time)]
name = "Predicted_more_by_GCN" if given.predict_more else "[metrics]Predicted_by_GCN_on_test_views"
place = model / given.exp_name / name / f"ours_{given.ckpt_iteration}" / "renders"
place = place / "view0" if given.predict_more else place
place.mkdir(parents=True)
for i in range(given.frames if given.predict_more else len(held)):
    shutil.copy(data / (held[i % len(held)] + ".png"), place / f"{i:05d}.png")
"""
TORCH = """
__version__ = '1.13'
class version:
    cuda = '11.7'
class cuda:
    is_available = staticmethod(lambda: {})
"""


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    place = tmp_path / "checkout"
    (place / "scene").mkdir(parents=True)
    (place / "scene" / "__init__.py").touch()
    (place / "train.py").write_text(TRAIN, encoding="utf-8")
    (place / "train_GCN.py").write_text(FORECAST, encoding="utf-8")
    (place / "scene" / "dataset_readers.py").write_text(READERS, encoding="utf-8")
    for name in SUBMODULES:
        (place / name).mkdir(parents=True)
        (place / name / "setup.py").touch()
    return place


@pytest.fixture
def python(tmp_path: Path) -> str:
    """An interpreter whose torch is a few lines that claim a CUDA device."""
    return interpreter(tmp_path, "True")


def interpreter(tmp_path: Path, available: str) -> str:
    packages = tmp_path / "packages"
    packages.mkdir(exist_ok=True)
    (packages / "torch.py").write_text(TORCH.format(available), encoding="utf-8")
    script = tmp_path / "python"
    script.write_text(f'#!/bin/sh\nPYTHONPATH={packages} exec {sys.executable} "$@"\n', encoding="utf-8")
    script.chmod(0o755)
    return str(script)


def settings(**changes: object) -> AuthorsConfig:
    schema = OmegaConf.structured(AuthorsConfig)
    return OmegaConf.to_object(OmegaConf.merge(schema, OmegaConf.load(CONF), {"free_frames": 20}, changes))


def test_a_clip_goes_through_the_tool_and_its_frames_come_back(
    checkout: Path, python: str, tmp_path: Path
) -> None:
    config = settings(checkout=str(checkout), python=python)
    said: list[str] = []
    found = predict_frames(
        FRAMES, config, n_train=9, place=tmp_path / "place", say=lambda what: said.append(str(what))
    )
    np.testing.assert_array_equal(found[:3], FRAMES[9:])
    assert len(found) == 20
    trained = json.loads((tmp_path / "place/d-nerf/model/trained.json").read_text(encoding="utf-8"))
    assert trained["radius"] == 4.4
    assert any("train_GCN.py" in text for text in said)


def test_frames_from_elsewhere_need_no_tool(tmp_path: Path, checkout: Path, python: str) -> None:
    config = settings(checkout=str(checkout), python=python)
    predict_frames(FRAMES, config, n_train=9, place=tmp_path / "place", say=lambda what: None)
    folder = tmp_path / "place/data/frames"
    read = settings(frames=str(folder))
    found = predict_frames(FRAMES, read, n_train=9, place=tmp_path, say=lambda what: None)
    np.testing.assert_array_equal(found, FRAMES)
    with pytest.raises(ValueError, match="12 predicted frames, but 33"):
        predict_frames(np.repeat(FRAMES, 3, 0), read, n_train=3, place=tmp_path, say=lambda what: None)


def test_what_is_given_to_the_training_is_given_to_the_forecast() -> None:
    config = settings(checkout="somewhere", python="python3")
    train = make_train_command(config, data=Path("data"), model=Path("d-nerf/m"), max_time=0.755)
    tested = make_forecast_command(config, model=Path("d-nerf/m"), max_time=0.755, free=False)
    free = make_forecast_command(config, model=Path("d-nerf/m"), max_time=0.755, free=True)
    for option in ("--max_points", "--time_freq", "--nearest_num", "--feature_amplify", "--max_time", "-m"):
        values = {command[command.index(option) + 1] for command in (train, tested, free)}
        assert len(values) == 1, option
    assert train[train.index("-m") + 1].endswith("/")
    assert "--metrics" in tested
    assert "--evaluate" in free
    assert free[free.index("--frames") + 1] == "20"


def test_a_checkout_without_submodules_is_refused(checkout: Path) -> None:
    assert check_checkout(str(checkout)) == checkout
    (checkout / SUBMODULES[1] / "setup.py").unlink()
    with pytest.raises(ValueError, match="git submodule update") as caught:
        check_checkout(str(checkout))
    assert SUBMODULES[1] in str(caught.value)
    (checkout / "train_GCN.py").unlink()
    with pytest.raises(FileNotFoundError, match=r"no train_GCN\.py in it"):
        check_checkout(str(checkout))
    with pytest.raises(FileNotFoundError, match="no such folder"):
        check_checkout(str(checkout / "gone"))


def test_no_cuda_is_said_before_anything_is_run(tmp_path: Path, checkout: Path) -> None:
    python = interpreter(tmp_path, "False")
    with pytest.raises(RuntimeError, match="no CUDA device"):
        check_cuda(python)
    config = settings(checkout=str(checkout), python=python)
    with pytest.raises(RuntimeError, match=r"authors\.frames"):
        predict_frames(FRAMES, config, n_train=9, place=tmp_path / "place", say=lambda what: None)
    assert not (tmp_path / "place").exists()
    with pytest.raises(FileNotFoundError, match="no such interpreter"):
        check_cuda(str(tmp_path / "gone"))
    (tmp_path / "packages" / "torch.py").write_text("raise ImportError('no torch here')", encoding="utf-8")
    with pytest.raises(RuntimeError, match="no torch here"):
        check_cuda(python)


def test_a_tool_that_fails_is_quoted(tmp_path: Path, checkout: Path, python: str) -> None:
    config = settings(checkout=str(checkout), python=python)
    command = make_train_command(config, data=tmp_path / "gone", model=tmp_path / "d-nerf", max_time=0.5)
    with pytest.raises(RuntimeError, match="No such file") as caught:
        run_tool(command, checkout=checkout)
    assert "train.py" in str(caught.value)
    (checkout / "scene" / "dataset_readers.py").write_text("", encoding="utf-8")
    with pytest.raises(RuntimeError, match="another version of the tool"):
        run_tool(command, checkout=checkout)


def test_settings_that_contradict_each_other_are_refused() -> None:
    with pytest.raises(ValueError, match="give one of them"):
        settings(checkout="a", python="b", frames="c")
    with pytest.raises(ValueError, match=r"needs authors\.python"):
        settings(checkout="a")
    with pytest.raises(ValueError, match=r"authors\.epochs"):
        settings(epochs=0)
