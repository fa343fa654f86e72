"""The matter that a pointer in space can take hold of: where the Gaussians that move stop light."""

import numpy as np
import torch
from jaxtyping import Float64, Int64
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from lagsplat.forces.equilibrium import OperatingPoint
from lagsplat.splat.projection import SQUARE
from lagsplat.viewer.rendering.overlays import select_moving

OPAQUE = 0.3
"""Of the light: a Gaussian is taken to end where it stops less by itself."""
MOST = 1200
"""Gaussians that a browser is asked to keep track of; the largest are taken."""
NOWHERE = 1e-4
STATES = 16


class DragProxies:
    """Ellipsoids on the Gaussians that move and are seen somewhere on the way, in the run's coordinates.

    ``moves`` (K,) says which of the decoder's Gaussians move at all.
    """

    def __init__(self, held: OperatingPoint) -> None:
        self.kinematics = held.kinematics
        seen = self._presence_on_the_way(held)
        with torch.no_grad():
            covariance = held.autoencoder.gaussians.covariance().cpu().double()
        values, vectors = np.linalg.eigh(covariance[:, SQUARE].unflatten(1, (3, 3)).numpy())
        sigma = np.sqrt(np.clip(values, 0.0, None))
        self.moves = torch.from_numpy(select_moving(self.kinematics))
        size = torch.from_numpy(sigma[:, 1:].prod(1)) * (self.moves & (seen > OPAQUE))
        order = size.argsort(descending=True)[:MOST]
        self.chosen = order[size[order] > 0].sort().values
        self.sigma = sigma[self.chosen.numpy()]
        # a rotation, where the eigenvectors may also be a reflection
        axes = vectors[self.chosen.numpy()]
        self.axes = axes * np.sign(np.linalg.det(axes))[:, None, None]

    def turned(self, flip: Float64[np.ndarray, "3"]) -> Float64[np.ndarray, "K 4"]:
        """Orientations (w, x, y, z) of the ellipsoids in coordinates that are ``flip`` times the run's."""
        return Rotation.from_matrix(flip[:, None] * self.axes).as_quat(scalar_first=True)

    def at(
        self, q: Float64[np.ndarray, " d"]
    ) -> tuple[Float64[np.ndarray, "K 3"], Float64[np.ndarray, "K 3"]]:
        """Centres and half axes [px at the pivot] at a whitened state; half axes of what is faded vanish."""
        state = torch.from_numpy(q)[None]
        place = self.kinematics.places(state)[0, self.chosen].numpy()
        present = self.kinematics.presence(state)[0, self.chosen].numpy()
        ends = np.sqrt(2.0 * np.log(np.maximum(present / OPAQUE, 1.0)))
        return place, np.maximum(ends[:, None] * self.sigma, NOWHERE)

    def _presence_on_the_way(self, held: OperatingPoint) -> torch.Tensor:
        states = held.chart.train.latents
        rows = np.linspace(0, len(states) - 1, min(STATES, len(states))).astype(int)
        visited = torch.cat([held.rest[None], torch.from_numpy(states[rows])])
        return self.kinematics.presence(visited).amax(0)


def make_ball() -> tuple[Float64[np.ndarray, "12 3"], Int64[np.ndarray, "20 3"]]:
    """Corners and triangles of an icosahedron around the unit ball's middle, with its corners on it."""
    golden = 0.5 * (1.0 + np.sqrt(5.0))
    corners = np.array([(0.0, a, b * golden) for a in (-1, 1) for b in (-1, 1)])
    corners = np.concatenate([np.roll(corners, turn, axis=1) for turn in range(3)])
    corners /= np.linalg.norm(corners[0])
    return corners, ConvexHull(corners).simplices.astype(np.int64)
