"""Draw a given cloud of Gaussians, such as a frame lifted by SHARP; nothing is learned here."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float32, Float64, UInt8
from scipy.spatial.transform import Rotation
from torch import Tensor

from lagsplat.io.files.ply import PlyCloud
from lagsplat.splat.gaussians import GaussianSlice
from lagsplat.splat.image_model import BLUR_PX2, choose_device, rasterize
from lagsplat.splat.projection import View, compute_depths, make_view, project
from lagsplat.views.camera import Camera

FAINT = 0.005  # opacity below which a Gaussian is left out
OPAQUE = 0.99


class PointCloudScene(NamedTuple):
    """What the cameras see: sRGB colours, covered share of each pixel, mean depth (0 without cover)."""

    images: UInt8[np.ndarray, "V H W 3"]
    cover: Float32[np.ndarray, "V H W"]
    depth: Float32[np.ndarray, "V H W"]


@torch.no_grad()
def build_point_cloud(cloud: PlyCloud, cameras: Sequence[Camera], *, blur_px2: float) -> PointCloudScene:
    """Draw a cloud whose sRGB colours blend in linear light, on black; ``cameras`` are one per image.

    ``blur_px2`` is added to the drawn covariances instead of the 0.3 of training.

    Source: the renderer of SHARP, arXiv:2512.10685.
    """
    device = choose_device("auto")
    kept = cloud.opacities >= FAINT
    rows, columns = np.tril_indices(3)
    packed = cloud.covariances()[kept][:, rows, columns]
    parts = [cloud.means[kept], packed, cloud.opacities[kept], srgb_to_linear(cloud.colors[kept].clip(0, 1))]
    means, covariance, opacity, color = (
        torch.as_tensor(part, dtype=torch.float32, device=device) for part in parts
    )
    scene = GaussianSlice(means[None], covariance, opacity[None].clamp(max=1.0), color, color.new_zeros(3))
    shown = [_draw(scene, camera, blur_px2) for camera in cameras]
    light, cover, depth = (torch.cat(each).cpu().numpy() for each in zip(*shown, strict=True))
    images = np.round(255 * linear_to_srgb(light.clip(0, 1))).astype(np.uint8)
    return PointCloudScene(np.ascontiguousarray(np.moveaxis(images, 1, 3)), cover, depth)


def _draw(scene: GaussianSlice, camera: Camera, blur_px2: float) -> tuple[Tensor, Tensor, Tensor]:
    """Light (1, 3, H, W), cover and depth (1, H, W) of one camera."""
    height, width = camera.height, camera.width
    view = View(*(part.to(scene.means) for part in make_view([camera])))
    ahead = compute_depths(scene.means, view)
    # Depth and presence are drawn in place of colours.
    labels = torch.stack([ahead, torch.ones_like(ahead), torch.zeros_like(ahead)], dim=2)
    labelled = scene._replace(color=torch.cat([scene.color[None], labels], dim=2))
    flat = project(labelled, view, height=height, width=width)
    sharp = flat.covariance + flat.covariance.new_tensor([1.0, 0.0, 1.0]) * (blur_px2 - BLUR_PX2)
    parts = [flat._replace(covariance=sharp, color=part.contiguous()) for part in flat.color.split(3, 2)]
    light, other = (rasterize(*part, height=height, width=width, backend="auto") for part in parts)
    cover = other[:, 1]
    return light, cover, torch.where(cover > FAINT, other[:, 0] / cover.clamp_min(FAINT), 0.0)


def merge_clouds(cloud: PlyCloud, *, side: int, by: int, layers: int) -> PlyCloud:
    """Merge ``by`` x ``by`` cells of each grid of Gaussians into one of equal mean and covariance.

    Weights are the opacities; the merged Gaussian stops the light of its parts, spread over its extent.

    ``cloud`` holds ``layers`` grids of ``side`` x ``side`` Gaussians, row by row.

    Raises:
        ValueError: the number of Gaussians is another, or ``by`` does not divide the side.
    """
    count = len(cloud.means)
    if count != layers * side * side or side % by:
        raise ValueError(f"{count} Gaussians are not {layers} grids of {side} x {side} that {by} divides")
    weight = _blocks(cloud.opacities[:, None], layers, side, by).clip(1e-6)
    share = weight / weight.sum(1, keepdims=True)
    light = srgb_to_linear(cloud.colors.clip(0, 1))
    means, colors = (_blocks(part, layers, side, by) for part in (cloud.means, light))
    covariances = _blocks(cloud.covariances().reshape(-1, 9), layers, side, by)
    middle = (share * means).sum(1)
    away = means - middle[:, None]
    outer = (away[..., :, None] * away[..., None, :]).reshape(*away.shape[:2], 9)
    full = (share * (covariances + outer)).sum(1).reshape(-1, 3, 3)
    stopped = -np.log1p(-weight[..., 0].clip(max=OPAQUE))
    area = _face(covariances.reshape(*covariances.shape[:2], 3, 3), means)
    total = (stopped * area).sum(1) / np.maximum(_face(full[:, None], middle[:, None])[:, 0], 1e-30)
    values, vectors = np.linalg.eigh(full)
    return PlyCloud(
        means=middle,
        scales=np.sqrt(np.maximum(values, 1e-18)),
        quaternions=to_quaternions(vectors),
        colors=linear_to_srgb((share * colors).sum(1)),
        opacities=(1 - np.exp(-total)).clip(max=OPAQUE),
    )


def _blocks(values: Float64[np.ndarray, "N c"], layers: int, side: int, by: int) -> np.ndarray:
    """Group rows of a grid by merged cell: (blocks, by * by, c)."""
    few = side // by
    grid = values.reshape(layers, few, by, few, by, -1).transpose(0, 1, 3, 2, 4, 5)
    return grid.reshape(layers * few * few, by * by, values.shape[1])


def _face(covariance: np.ndarray, means: np.ndarray) -> np.ndarray:
    """Area that each Gaussian presents to a camera at the origin, up to a factor."""
    xx, xy, yy = covariance[..., 0, 0], covariance[..., 0, 1], covariance[..., 1, 1]
    return np.sqrt(np.maximum(xx * yy - xy * xy, 0)) / np.maximum(means[..., 2], 1e-6) ** 2


def to_quaternions(axes: Float64[np.ndarray, "N 3 3"]) -> Float64[np.ndarray, "N 4"]:
    """Unit quaternions (w, x, y, z) of orthonormal matrices; reflections are negated first."""
    turns = axes * np.sign(np.linalg.det(axes))[:, None, None]
    return Rotation.from_matrix(turns).as_quat(scalar_first=True)


def srgb_to_linear(color: np.ndarray) -> np.ndarray:
    """Convert sRGB colours in [0, 1] to linear light. Source: IEC 61966-2-1."""
    return np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(light: np.ndarray) -> np.ndarray:
    """Convert linear light in [0, 1] to sRGB colours. Source: IEC 61966-2-1."""
    bright = 1.055 * np.maximum(light, 0.0031308) ** (1 / 2.4) - 0.055
    return np.where(light <= 0.0031308, 12.92 * light, bright)
