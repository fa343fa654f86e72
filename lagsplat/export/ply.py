"""A state of a trained run as a PLY that viewers of 3D Gaussian Splatting open."""

from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.chart.chart import Chart
from lagsplat.io.files.ply import PlyCloud, write_cloud
from lagsplat.splat.image_model import ALPHA_MIN
from lagsplat.splat.point_cloud import LOWER, covariances_to_quaternions
from lagsplat.stage1.autoencoder import Autoencoder

THIN = 1e-3
"""[px] Thickness of Gaussians of the picture, and their distance from each other in their order."""
FLAT = 1e-9
"""[px^2] Least variance that is told."""


def export_ply(autoencoder: Autoencoder, chart: Chart, q: Float64[np.ndarray, " d"], out: Path) -> None:
    """Write the Gaussians that are present at the whitened state ``q``.

    Coordinates are those of the film's camera, x to the right, y down, z ahead, in units of the depth of its
    pivot; Gaussians of the picture lie on a plane there, in the order in which they cover each other. The
    background colour is not a Gaussian and is left out.

    Raises:
        ValueError: the state has another dimension, is not finite, or nothing is present there.
    """
    if q.shape != (chart.d,) or not np.isfinite(q).all():
        raise ValueError(f"the state {q.tolist()} is not one of {chart.d} finite coordinates")
    cloud = cloud_at(autoencoder, chart.to_raw(q[None]))
    if not len(cloud.means):
        raise ValueError(
            f"no Gaussian is present at the state {q.tolist()}: it lies outside what the recording showed"
        )
    write_cloud(out, cloud)


@torch.no_grad()
def cloud_at(autoencoder: Autoencoder, z: Float64[np.ndarray, "1 d"]) -> PlyCloud:
    """The Gaussians drawn at a raw latent, in units of the pivot's depth."""
    model = autoencoder.gaussians
    scene = model.condition(torch.from_numpy(z).to(model.center))
    means, packed, opacity = (
        part.double().cpu().numpy() for part in (scene.means[0], scene.covariance, scene.opacity[0])
    )
    if model.space == 3:
        unit = float(autoencoder.filmed_view(model.center).focal[0, 0])
    else:
        means, packed, unit = _stood_up(means, packed, autoencoder.height, autoencoder.width)
    full = np.zeros((len(means), 3, 3))
    for entry, (i, j) in enumerate(LOWER):
        full[:, i, j] = full[:, j, i] = packed[:, entry]
    values, vectors = np.linalg.eigh(full)
    shown = opacity >= ALPHA_MIN
    return PlyCloud(
        means=means[shown] / unit,
        scales=np.sqrt(np.maximum(values[shown], FLAT)) / unit,
        quaternions=covariances_to_quaternions(vectors[shown]),
        colors=scene.color.double().cpu().numpy()[shown],
        opacities=opacity[shown],
    )


def _stood_up(
    means: np.ndarray, packed: np.ndarray, height: int, width: int
) -> tuple[np.ndarray, np.ndarray, float]:
    """Gaussians of a picture on a plane one picture's width ahead, thin, the first in front."""
    order = np.arange(len(means))[:, None] * THIN / max(len(means), 1)
    solid = np.concatenate([means - 0.5 * np.array([width, height]), width + order], axis=1)
    nothing = np.zeros((len(means), 2))
    return solid, np.concatenate([packed, nothing, np.full((len(means), 1), THIN**2)], axis=1), float(width)
