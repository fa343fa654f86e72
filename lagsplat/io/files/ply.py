"""Clouds of Gaussians in PLY files, as SHARP writes them and 3D Gaussian Splatting viewers open them.

The layout is that of Kerbl et al. 2023, without view dependence: an element ``vertex`` with the properties x
y z (nx ny nz) f_dc_0..2 opacity scale_0..2 rot_0..3, binary little endian, float32. Scales are natural
logarithms of standard deviations, opacity is a logit, rot a quaternion (w, x, y, z), and a colour is ``0.5 +
f_dc / sqrt(4 pi)``. SHARP adds elements of one property each with the camera (`SharpCloud`).
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from plyfile import PlyData, PlyElement, PlyParseError
from scipy.spatial.transform import Rotation

from lagsplat.io.files.atomic import StrPath, replace_atomically

HARMONIC = float(np.sqrt(1 / (4 * np.pi)))  # the spherical harmonic of degree 0
COLORS, SCALES, TURNS = (
    tuple(f"{name}_{i}" for i in range(n)) for name, n in (("f_dc", 3), ("scale", 3), ("rot", 4))
)
FIELDS = ("x", "y", "z", *COLORS, "opacity", *SCALES, *TURNS)
NORMALS = ("nx", "ny", "nz")


@dataclass(frozen=True)
class PlyCloud:
    """N Gaussians in space."""

    means: Float64[np.ndarray, "N 3"]
    scales: Float64[np.ndarray, "N 3"]  # standard deviations
    quaternions: Float64[np.ndarray, "N 4"]  # (w, x, y, z)
    colors: Float64[np.ndarray, "N 3"]  # as stored, in [0, 1] or slightly outside
    opacities: Float64[np.ndarray, " N"]  # in [0, 1]

    def covariances(self) -> Float64[np.ndarray, "N 3 3"]:
        """Covariance matrices of the Gaussians."""
        turn = Rotation.from_quat(self.quaternions, scalar_first=True).as_matrix()
        factor = turn * self.scales[:, None]
        return factor @ factor.transpose(0, 2, 1)


@dataclass(frozen=True)
class SharpCloud:
    """A cloud as SHARP writes it: in the camera's own coordinates [m], colours encoded as sRGB."""

    cloud: PlyCloud
    focal: float  # [px], of an image of this size with the principal point at its centre
    width: int
    height: int


def read_sharp(path: StrPath) -> SharpCloud:
    """Read a frame that SHARP lifted.

    Raises:
        ValueError: not a PLY of this layout, incomplete, or of linear colours; the message says which.
    """
    elements = read_elements(path)
    for name in ("intrinsic", "image_size"):
        if name not in elements:
            raise ValueError(f"{path}: no element {name!r}, which SHARP writes; the PLY is of another tool")
    if "color_space" in elements and int(elements["color_space"]["color_space"][0]) != 0:
        raise ValueError(f"{path}: its colours are linear; SHARP writes sRGB, color_space 0")
    lens = elements["intrinsic"]["intrinsic"].astype(float)
    width, height = (int(size) for size in elements["image_size"]["image_size"])
    if len(lens) != 9 or not np.allclose(lens[[2, 5]], [width / 2, height / 2], atol=1e-3):
        raise ValueError(f"{path}: intrinsic {lens.tolist()} does not fit SHARP's {width} x {height} picture")
    return SharpCloud(_cloud(path, elements), float(lens[0]), width, height)


def read_cloud(path: StrPath) -> PlyCloud:
    """Read the Gaussians of a PLY in the layout of 3D Gaussian Splatting; errors as `read_sharp`."""
    return _cloud(path, read_elements(path))


def write_cloud(path: StrPath, cloud: PlyCloud) -> None:
    """Write a cloud in the layout of 3D Gaussian Splatting, atomically."""
    names = (*FIELDS[:3], *NORMALS, *FIELDS[3:])
    table = np.zeros(len(cloud.means), dtype=[(name, "<f4") for name in names])
    alpha = np.clip(cloud.opacities, 1e-6, 1 - 1e-6)
    columns = [
        cloud.means,
        (cloud.colors - 0.5) / HARMONIC,
        (np.log(alpha) - np.log1p(-alpha))[:, None],
        np.log(cloud.scales),
        cloud.quaternions,
    ]
    for name, column in zip(FIELDS, np.concatenate(columns, axis=1).T, strict=True):
        table[name] = column
    with replace_atomically(path) as temporary:
        PlyData([PlyElement.describe(table, "vertex")], byte_order="<").write(temporary)


def is_whole(path: StrPath) -> bool:
    """Whether a PLY that another program is writing has all bytes that its header declares."""
    try:
        read_elements(path)
    except (ValueError, FileNotFoundError):
        return False
    return True


def read_elements(path: StrPath) -> dict[str, np.ndarray]:
    """Read every element of a PLY as a table with one column per property, mapped from the file.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is no PLY, or ends before its last element.
    """
    try:
        return {element.name: element.data for element in PlyData.read(path).elements}
    except (PlyParseError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: not a whole PLY file ({error}); delete it and make it again") from error


def _cloud(path: StrPath, elements: dict[str, np.ndarray]) -> PlyCloud:
    vertex = elements.get("vertex")
    names = () if vertex is None else vertex.dtype.names or ()
    if vertex is None or (missing := [name for name in FIELDS if name not in names]):
        lacking = "vertex" if vertex is None else f"properties {missing}"
        raise ValueError(f"{path}: not Gaussians: no {lacking}, only {list(names) or list(elements)}")
    table = np.stack([vertex[name].astype(np.float64) for name in FIELDS], axis=1)
    logit = np.clip(table[:, 6], -700, 700)  # an opacity of exactly 0 or 1 is stored as infinity
    return PlyCloud(
        means=table[:, :3],
        scales=np.exp(table[:, 7:10]),
        quaternions=table[:, 10:],
        colors=0.5 + HARMONIC * table[:, 3:6],
        opacities=1 / (1 + np.exp(-logit)),
    )
