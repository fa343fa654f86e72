"""Clouds of Gaussians: genuine files of SHARP are read as by their authors, and drawn as elsewhere."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from plyfile import PlyData

from lagsplat.io.files.ply import PlyCloud, is_whole, read_cloud, read_elements, read_sharp, write_cloud
from lagsplat.splat.point_cloud import (
    build_point_cloud,
    linear_to_srgb,
    merge_clouds,
    srgb_to_linear,
    to_quaternions,
)
from lagsplat.views.camera import Camera, center_camera


def small(count: int = 20) -> PlyCloud:
    rng = np.random.default_rng(0)
    turn = rng.normal(size=(count, 4))
    return PlyCloud(
        means=rng.normal(size=(count, 3)) + np.array([0, 0, 5]),
        scales=rng.uniform(0.01, 0.2, (count, 3)),
        quaternions=turn / np.linalg.norm(turn, axis=1, keepdims=True),
        colors=rng.random((count, 3)),
        opacities=rng.uniform(0.1, 0.9, count),
    )


def camera_of(world_to_camera: np.ndarray, focal: float, height: int, width: int) -> Camera:
    turn = world_to_camera[:3, :3]
    return center_camera(turn, -turn.T @ world_to_camera[:3, 3], focal=focal, height=height, width=width)


def psnr(one: np.ndarray, other: np.ndarray) -> float:
    return float(10 * np.log10(255**2 / np.square(one.astype(float) - other.astype(float)).mean()))


def test_a_cloud_comes_back_from_its_file(tmp_path: Path) -> None:
    cloud = small()
    write_cloud(tmp_path / "a.ply", cloud)
    back = read_cloud(tmp_path / "a.ply")
    for name in ("means", "scales", "quaternions", "colors", "opacities"):
        np.testing.assert_allclose(getattr(back, name), getattr(cloud, name), rtol=1e-5, atol=1e-6)
    names = read_elements(tmp_path / "a.ply")["vertex"].dtype.names
    assert names[:7] == ("x", "y", "z", "nx", "ny", "nz", "f_dc_0")


def test_files_that_are_none_or_half_written_are_told(tmp_path: Path) -> None:
    whole, half = tmp_path / "a.ply", tmp_path / "half.ply"
    write_cloud(whole, small())
    assert is_whole(whole)
    half.write_bytes(whole.read_bytes()[:-30])
    assert not is_whole(half)
    with pytest.raises(ValueError, match=r"not a whole PLY file.*'vertex': row 19: early end-of-file"):
        read_cloud(half)
    half.write_bytes(whole.read_bytes()[:50])
    assert not is_whole(half)
    assert not is_whole(tmp_path / "none.ply")
    with pytest.raises(ValueError, match="not a whole PLY file"):
        read_cloud(half)
    half.write_bytes(whole.read_bytes().replace(b"opacity", b"opaqueness"))
    with pytest.raises(ValueError, match=r"not Gaussians: no properties \['opacity'\]"):
        read_cloud(half)
    with pytest.raises(ValueError, match="no element 'intrinsic'"):
        read_sharp(whole)


@pytest.mark.parametrize("encoding", [{"byte_order": ">"}, {"text": True}], ids=str)
def test_other_encodings_of_the_format_are_read(tmp_path: Path, encoding: dict[str, Any]) -> None:
    write_cloud(tmp_path / "a.ply", small())
    PlyData(PlyData.read(tmp_path / "a.ply").elements, **encoding).write(tmp_path / "b.ply")
    np.testing.assert_allclose(read_cloud(tmp_path / "b.ply").means, small().means, rtol=1e-5)


def test_genuine_files_are_decoded_as_by_their_authors(shared_data: Path) -> None:
    truth = np.load(shared_data / "sharp" / "synthetic_rainbow_truth.npz")
    ply = read_sharp(shared_data / "sharp" / "synthetic_rainbow.ply")
    assert (ply.focal, ply.width, ply.height) == (
        float(truth["f_px"]),
        int(truth["width"]),
        int(truth["height"]),
    )
    np.testing.assert_allclose(ply.cloud.means, truth["means"], atol=1e-7)
    np.testing.assert_allclose(ply.cloud.scales, truth["scales"], rtol=1e-6)
    np.testing.assert_allclose(ply.cloud.opacities, truth["opacities"], atol=1e-6)
    np.testing.assert_allclose(ply.cloud.colors, truth["colors_srgb"], atol=1e-6)
    np.testing.assert_allclose(srgb_to_linear(ply.cloud.colors), truth["colors_linear"], atol=1e-6)
    dots = np.abs((ply.cloud.quaternions * truth["quats_wxyz"]).sum(1))
    np.testing.assert_allclose(dots, 1.0, atol=1e-6)


@pytest.mark.parametrize("name", ["ref", "yaw+10", "yaw-10_pitch+5"])
def test_genuine_files_are_drawn_as_by_an_independent_renderer(shared_data: Path, name: str) -> None:
    ply = read_sharp(shared_data / "sharp" / "synthetic_rainbow.ply")
    views = np.load(shared_data / "sharp" / "synthetic_rainbow_views.npz")
    camera = camera_of(views[f"w2c_{name}"], ply.focal, ply.height, ply.width)
    shown = build_point_cloud(ply.cloud, [camera], blur_px2=0.0)
    # Rows of the floor share their depth in the reference view: there the order among them is anyone's.
    assert psnr(shown.images[0], views[f"img_{name}"]) > (38 if name == "ref" else 40)
    assert np.abs(shown.cover[0] - views[f"alpha_{name}"]).mean() < 0.005


def test_the_front_of_a_lifted_photograph_is_the_photograph(shared_data: Path) -> None:
    ply = read_sharp(shared_data / "sharp" / "sharp_cli_astronaut_stride8.ply")
    photo = cv2.imread(str(shared_data / "sharp" / "astronaut_256x192.png"))[..., ::-1]
    camera = center_camera(np.eye(3), np.zeros(3), focal=ply.focal, height=ply.height, width=ply.width)
    small_camera = camera.resized(48, 64)
    shown = build_point_cloud(ply.cloud, [small_camera], blur_px2=0.3)
    wanted = cv2.resize(photo, (64, 48), interpolation=cv2.INTER_AREA)
    assert psnr(shown.images[0], wanted) > psnr(np.full_like(wanted, wanted.mean()), wanted) + 3


def test_quaternions_turn_back_into_their_matrices() -> None:
    cloud = small(200)
    turns = np.linalg.qr(np.random.default_rng(1).normal(size=(200, 3, 3)))[0]
    turns *= np.sign(np.linalg.det(turns))[:, None, None]
    unit = PlyCloud(
        cloud.means,
        np.tile([1.0, 2.0, 3.0], (200, 1)),
        to_quaternions(turns),
        cloud.colors,
        cloud.opacities,
    )
    scaled = turns * np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(unit.covariances(), scaled @ scaled.transpose(0, 2, 1), atol=1e-12)


def test_merged_cells_show_the_same_picture() -> None:
    side = 24
    x, y = (part.ravel() for part in np.meshgrid(np.arange(side), np.arange(side)))
    grid = np.stack([(x + 0.5) / side - 0.5, (y + 0.5) / side - 0.5, np.full(side * side, 1.0)], 1)
    color = np.stack([0.5 + 0.4 * np.sin(x / 4), 0.5 + 0.4 * np.cos(y / 5), np.full(side * side, 0.4)], 1)
    count = side * side
    shape = np.tile([1 / side, 1 / side, 0.01], (count, 1))
    layer = PlyCloud(grid, shape, np.tile([1.0, 0, 0, 0], (count, 1)), color, np.full(count, 0.6))
    names = ("means", "scales", "quaternions", "colors", "opacities")
    parts = [np.concatenate([getattr(layer, name)] * 2) for name in names]
    parts[0][side * side :, 2] += 0.5
    double = PlyCloud(*parts)
    few = merge_clouds(double, side=side, by=2, layers=2)
    assert len(few.means) == len(double.means) // 4
    camera = center_camera(np.eye(3), np.zeros(3), focal=12.0, height=12, width=12)
    full, rough = (build_point_cloud(cloud, [camera], blur_px2=0.3) for cloud in (double, few))
    assert psnr(full.images[0, 1:-1, 1:-1], rough.images[0, 1:-1, 1:-1]) > 30
    np.testing.assert_allclose(full.depth[0, 3:-3, 3:-3], 1.0, atol=0.02)
    np.testing.assert_allclose(rough.depth[0, 3:-3, 3:-3], 1.0, atol=0.02)
    with pytest.raises(ValueError, match="not 2 grids of 25 x 25 that 2 divides"):
        merge_clouds(double, side=25, by=2, layers=2)


def test_srgb_is_undone() -> None:
    color = np.linspace(0, 1, 101)
    np.testing.assert_allclose(linear_to_srgb(srgb_to_linear(color)), color, atol=1e-12)
