"""Films show the mechanism where it is and the camera as it stands."""

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.gapgen.make import main
from benchmarks.gapgen.mechanisms import draw_mechanism
from benchmarks.gapgen.render import SIDE, Camera, draw_look, film

SYSTEMS = ("pendulum", "rocker", "duffing_cart", "two_link", "bag", "soft_robot")
NOMINAL = Camera()


def shot(
    system: str, q: NDArray[np.float64], camera: Camera = NOMINAL, noise: float = 0.0
) -> NDArray[np.float64]:
    m = draw_mechanism(system, np.random.default_rng(1))
    look = draw_look(np.random.default_rng(2))
    rng = np.random.default_rng(3)
    frames = film(m, q * m.size, t0=0.0, look=look, camera=camera, noise=noise, rng=rng)
    return frames.astype(float)


@pytest.mark.parametrize("system", SYSTEMS)
def test_every_coordinate_is_seen_inside_the_frame(system: str) -> None:
    d = draw_mechanism(system, np.random.default_rng(1)).d
    poses = np.concatenate([np.zeros((1, d)), 0.5 * np.eye(d), -0.5 * np.eye(d)])
    frames = shot(system, poses)
    assert frames.shape == (2 * d + 1, 3, SIDE, SIDE)
    change = np.abs(frames[1:] - frames[0]).max(1)
    assert (change.max((1, 2)) > 30).all()
    edge = np.ones((SIDE, SIDE), bool)
    edge[1:-1, 1:-1] = False
    assert change[:, edge].max() < 1


def test_a_shift_of_the_camera_moves_the_picture() -> None:
    q = np.array([[0.3]])
    still = shot("pendulum", q)
    moved = shot("pendulum", q, Camera(shift_px=(5.0, -3.0)))
    assert np.abs(moved[:, :, :-3, 5:] - still[:, :, 3:, :-5]).max() <= 1
    drifting = shot("pendulum", np.repeat(q, 61, 0), Camera(px_per_s=(60_000 / 1001 / 10, 0.0)))
    assert np.abs(drifting[10, :, :, 1:] - drifting[0, :, :, :-1]).max() <= 1
    turned = shot("pendulum", q, Camera(rotation_deg=90.0))
    assert np.abs(turned[0] - np.rot90(still[0], -1, (1, 2))).max() <= 1


def test_a_long_exposure_is_the_mean_of_what_was_there() -> None:
    q = np.linspace(-1.0, 1.0, 40)[:, None]
    sharp, blurred = shot("duffing_cart", q), shot("duffing_cart", q, Camera(exposure_s=0.1))
    assert sharp[30].std() > blurred[30].std()
    assert np.abs(blurred[0] - sharp[0]).max() <= 1


def test_noise_is_as_strong_as_asked() -> None:
    q = np.zeros((8, 1))
    rest = shot("rocker", q, noise=0.02) - shot("rocker", q)
    inside = (shot("rocker", q) > 40) & (shot("rocker", q) < 215)
    assert abs(rest[inside].std() / 255.0 - 0.02) < 5e-4


def test_a_filmed_split_holds_archives_of_pictures_and_inputs(tmp_path: Path) -> None:
    call = ["--split", "t", "--key", "films", "--n", "1", "--out", str(tmp_path), "--systems", "d1"]
    main([*call, "--tier", "T1"])
    (answer,) = [json.loads(line) for line in (tmp_path / "answers.jsonl").read_text().splitlines()]
    assert answer["tier"] == "T1"
    paths = sorted((tmp_path / "data" / answer["id"]).glob("*.npz"))
    assert {path.name.split("_")[0] for path in paths} == {"sim", "real"}
    for path in paths:
        with np.load(path) as archive:
            frames = archive["images"]
            assert frames.dtype == np.uint8
            assert frames.shape[1:] == (3, SIDE, SIDE)
            assert all(archive[name].shape == (len(frames),) for name in archive.files if name != "images")
            assert ("p1" in archive.files) == answer["forced"]
