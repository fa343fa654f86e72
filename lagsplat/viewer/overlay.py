"""What can be laid over the picture: where the object rests, and how its matter moves or is pushed."""

import numpy as np
import torch
from jaxtyping import Bool, Float64
from scipy.ndimage import gaussian_filter
from scipy.spatial import KDTree
from skimage.measure import find_contours

from lagsplat.forces.held import Held
from lagsplat.forces.kinematics import Kinematics
from lagsplat.forces.outline import outlined
from lagsplat.forces.scene import scene_at

CELLS = 14
"""Cells along the longer side of the picture in each of which one arrow stands."""
PRESENT = 0.2
MOVES = 0.1
"""Of the largest motion: what moves less is ground, gets no arrow and in space cannot be dragged."""
LARGEST = 0.98
COMPANY = 4
STRAY = 3.0
"""Of the usual distance to the fourth neighbour that moves: what is further from its own is alone."""
FINER = 2
"""Times the training resolution at which the outline is cut."""
SHORT = 12
"""Corners: specks have fewer."""


def rest_outline(held: Held) -> list[Float64[np.ndarray, "n 2"]]:
    """Outlines [px of the training resolution] of the object where it rests."""
    rest = held.rest[None]
    seen = outlined(
        held.pictures(rest, scale=FINER)[0], scene_at(held.autoencoder, held.chart, rest[0].numpy())
    )
    return [line / FINER for line in outlines(seen.astype(np.float64), smooth_px=float(FINER))]


def outlines(share: Float64[np.ndarray, "H W"], *, smooth_px: float) -> list[Float64[np.ndarray, "n 2"]]:
    """Where a picture crosses one half, smoothed, as lines through corners (x, y) [px]."""
    smooth = np.pad(gaussian_filter(share, smooth_px), 1)
    return [line[:, ::-1] - 0.5 for line in find_contours(smooth, 0.5) if len(line) > SHORT]


def moving(kinematics: Kinematics) -> Bool[np.ndarray, " K"]:
    """Which Gaussians move and are neither ground nor stray: a few that hang about alone help a decoder to
    reach the last decimal, but belong to no object.
    """
    motion = kinematics.geometry.jacobian.flatten(1).norm(dim=1).numpy()
    moves = motion >= MOVES * np.quantile(motion, LARGEST)
    if moves.sum() > COMPANY:
        centers = kinematics.center[torch.from_numpy(moves)].numpy()
        away = KDTree(centers).query(centers, COMPANY + 1)[0][:, -1]
        moves[moves] = away <= STRAY * np.median(away)
    return moves


class Field:
    """Arrows on the matter: one Gaussian a cell, the one most present, followed along its own Jacobian."""

    def __init__(self, held: Held) -> None:
        kinematics = held.kinematics
        places = kinematics.places(held.rest[None])[0].numpy()
        present = kinematics.presence(held.rest[None])[0].numpy()
        motion = kinematics.geometry.jacobian.flatten(1).norm(dim=1).numpy()
        cell = max(kinematics.height, kinematics.width) / CELLS
        usable = moving(kinematics) & (present > PRESENT)
        if kinematics.space == 2:
            usable &= ((places >= 0.0) & (places < (kinematics.width, kinematics.height))).all(1)
        best: dict[tuple[int, ...], int] = {}
        for i in np.argsort(present * motion):  # the last one written is the one that tells most
            if usable[i]:
                best[tuple((places[i] // cell).astype(int).tolist())] = int(i)
        self.chosen = torch.tensor(sorted(best.values()), dtype=torch.long)
        self.kinematics, self.cell = kinematics, cell
        self.jacobian = kinematics.geometry.jacobian[self.chosen].numpy()

    def places(self, q: Float64[np.ndarray, " d"]) -> Float64[np.ndarray, "n k"]:
        """Feet of the arrows [px]."""
        return self.kinematics.places(torch.from_numpy(q)[None])[0, self.chosen].numpy()

    def along(self, rate: Float64[np.ndarray, " d"]) -> Float64[np.ndarray, "n k"]:
        """What a rate of the state is to the matter at the feet [px per its unit]."""
        return self.jacobian @ rate

    def arrows(
        self, q: Float64[np.ndarray, " d"], rate: Float64[np.ndarray, " d"], *, largest: float
    ) -> Float64[np.ndarray, "n 2 k"]:
        """Feet and tips [px]; ``largest`` is the length [px per unit] drawn two cells long."""
        feet = self.places(q)
        return np.stack([feet, feet + self.along(rate) * (2.0 * self.cell / max(largest, 1e-12))], axis=1)
