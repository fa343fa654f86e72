"""Clouds as PLY files: what is written is read back, and what is no cloud of SHARP is refused by name."""

from pathlib import Path

import numpy as np
import pytest
from plyfile import PlyData, PlyElement

from lagsplat.io.files.ply import FIELDS, PlyCloud, is_whole, read_cloud, read_sharp, write_cloud

CLOUD = PlyCloud(
    means=np.array([[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]),
    scales=np.array([[0.1, 0.2, 0.3], [1.0, 1.0, 1.0]]),
    quaternions=np.array([[1.0, 0.0, 0.0, 0.0], [0.5, 0.5, 0.5, 0.5]]),
    colors=np.array([[0.0, 0.5, 1.0], [0.2, 0.3, 0.4]]),
    opacities=np.array([0.25, 0.75]),
)


def write_sharp(path: Path, lens: tuple[float, ...], size: tuple[int, int], space: int | None) -> Path:
    """A file in SHARP's layout with this lens, size of the image and space of colours."""
    plain = path.with_name("plain.ply")  # another file: what is read is mapped
    write_cloud(plain, CLOUD)
    elements = [*PlyData.read(plain).elements]
    for name, numbers, kind in (("intrinsic", lens, "<f4"), ("image_size", size, "<u4")):
        column = np.array([(number,) for number in numbers], dtype=[(name, kind)])
        elements.append(PlyElement.describe(column, name))
    if space is not None:
        elements.append(
            PlyElement.describe(np.array([(space,)], dtype=[("color_space", "u1")]), "color_space")
        )
    PlyData(elements, byte_order="<").write(path)
    return path


LENS = (50.0, 0.0, 32.0, 0.0, 50.0, 24.0, 0.0, 0.0, 1.0)


def test_a_cloud_comes_back(tmp_path: Path) -> None:
    write_cloud(tmp_path / "a.ply", CLOUD)
    found = read_cloud(tmp_path / "a.ply")
    for name, value in vars(CLOUD).items():
        np.testing.assert_allclose(getattr(found, name), value, atol=1e-6, err_msg=name)


def test_a_quarter_turn_moves_the_axes_of_a_covariance() -> None:
    turned = PlyCloud(
        means=np.zeros((1, 3)),
        scales=np.array([[1.0, 2.0, 3.0]]),
        quaternions=np.array([[np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]]),  # about z
        colors=np.zeros((1, 3)),
        opacities=np.ones(1),
    )
    np.testing.assert_allclose(turned.covariances(), [np.diag([4.0, 1.0, 9.0])], atol=1e-12)


@pytest.mark.parametrize("space", [0, None])
def test_a_file_of_sharp_has_a_lens_and_a_size(tmp_path: Path, space: int | None) -> None:
    found = read_sharp(write_sharp(tmp_path / "a.ply", LENS, (64, 48), space))
    assert (found.focal, found.width, found.height) == (50.0, 64, 48)
    np.testing.assert_allclose(found.cloud.means, CLOUD.means)


@pytest.mark.parametrize(
    ("lens", "space", "message"),
    [
        (LENS, 1, "its colours are linear; SHARP writes sRGB, color_space 0"),
        (LENS[:4], 0, "does not fit SHARP's 64 x 48 picture"),
        ((*LENS[:2], 31.0, *LENS[3:]), 0, "does not fit SHARP's 64 x 48 picture"),
    ],
)
def test_a_file_that_sharp_did_not_write_is_refused(tmp_path, lens, space, message) -> None:
    with pytest.raises(ValueError, match=message):
        read_sharp(write_sharp(tmp_path / "a.ply", lens, (64, 48), space))


def test_a_cloud_without_a_lens_is_of_another_tool(tmp_path: Path) -> None:
    write_cloud(tmp_path / "a.ply", CLOUD)
    with pytest.raises(ValueError, match="no element 'intrinsic', which SHARP writes"):
        read_sharp(tmp_path / "a.ply")


def test_other_elements_are_no_gaussians(tmp_path: Path) -> None:
    points = np.zeros(2, dtype=[(name, "<f4") for name in FIELDS[:3]])
    PlyData([PlyElement.describe(points, "vertex")]).write(tmp_path / "points.ply")
    with pytest.raises(ValueError, match=r"not Gaussians: no properties \['f_dc_0'"):
        read_cloud(tmp_path / "points.ply")
    PlyData([PlyElement.describe(points, "face")]).write(tmp_path / "faces.ply")
    with pytest.raises(ValueError, match=r"not Gaussians: no vertex, only \['face'\]"):
        read_cloud(tmp_path / "faces.ply")


def test_a_file_that_is_being_written_is_not_whole(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    assert not is_whole(path)
    write_cloud(path, CLOUD)
    assert is_whole(path)
    path.write_bytes(path.read_bytes()[:-1])
    assert not is_whole(path)
    with pytest.raises(ValueError, match=r"not a whole PLY file .* delete it and make it again"):
        read_cloud(path)
