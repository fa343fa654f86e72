"""Films through an encoder that only nominal films have trained."""

import json
from pathlib import Path

import numpy as np
import pytest

from lagsplat.config.compose import compose
from lagsplat.io.trajectory.trajectory import Trajectory, read_trajectory_file
from lagsplat.pipelines.batch import encode_videos

FRAME_S, SIDE = 0.02, 16
STEPS = 300


def film(path: Path, place: np.ndarray, *, shade: int = 255) -> None:
    """A bright disc at column ``place`` (T,) [px], with the place as pressure."""
    y, x = np.mgrid[:SIDE, :SIDE]
    far = (x - place[:, None, None]) ** 2 + (y - SIDE / 2) ** 2
    pictures = np.repeat((shade * np.exp(-far / 8.0))[:, None], 3, axis=1).astype(np.uint8)
    np.savez_compressed(path, images=pictures, p1=place)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two nominal films and one real one of a disc that swings along a row."""
    place = tmp_path_factory.mktemp("films")
    t = np.arange(120) * FRAME_S
    for name, phase, n in (
        ("sim_0", 0.0, 120),
        ("sim_10", 1.0, 80),
        ("sim_2", 2.0, 100),
        ("real_0", 0.5, 90),
    ):
        film(place / f"{name}.npz", 8.0 + 4.0 * np.sin(4.0 * t[:n] + phase))
    (place / "about.json").write_text(json.dumps({"coordinates": 1, "frame_s": FRAME_S}))
    return place


def seen(folder: Path, out: Path) -> dict[str, Trajectory]:
    config = compose("profile=toy", f"stage1.steps={STEPS}", "stage1.n_gaussians=40")
    encode_videos(folder, out, config.stage1, config.chart)
    return {name: read_trajectory_file(out / f"{name}_0.csv") for name in ("sim", "real")}


@pytest.fixture(scope="module")
def motions(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Trajectory]:
    """What the encoder sees."""
    return seen(folder, tmp_path_factory.mktemp("motions"))


def test_every_film_is_a_clip_in_the_order_of_their_numbers(motions: dict[str, Trajectory]) -> None:
    assert [b - a for a, b in motions["sim"].segments] == [120, 100, 80]
    assert motions["real"].n == 90
    assert motions["sim"].dt_s == pytest.approx(FRAME_S)
    assert (np.diff(motions["sim"].time_s) > 0.0).all()


def test_latents_follow_the_motion_on_both_sides(motions: dict[str, Trajectory]) -> None:
    for motion in motions.values():
        assert motion.d == 1
        assert abs(np.corrcoef(motion.q[:, 0], motion.u[:, 0])[0, 1]) > 0.9
    assert motions["sim"].q.std() == pytest.approx(1.0, rel=1e-2)


def test_real_films_teach_the_encoder_nothing(
    folder: Path, motions: dict[str, Trajectory], tmp_path: Path
) -> None:
    other = tmp_path / "films"
    other.mkdir()
    for path in folder.iterdir():
        (other / path.name).write_bytes(path.read_bytes())
    film(other / "real_0.npz", np.full(30, 3.0), shade=120)
    again = seen(other, tmp_path / "out")
    assert np.array_equal(again["sim"].q, motions["sim"].q)
    assert again["real"].n == 30


def test_a_side_without_films_is_named(tmp_path: Path) -> None:
    (tmp_path / "about.json").write_text(json.dumps({"coordinates": 1, "frame_s": FRAME_S}))
    config = compose("profile=toy")
    with pytest.raises(FileNotFoundError, match=r"sim_\*\.npz"):
        encode_videos(tmp_path, tmp_path / "out", config.stage1, config.chart)
