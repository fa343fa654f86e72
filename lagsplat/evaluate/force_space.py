"""Two forces in space on what one click takes hold of: one that cannot move it, and one that does."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from lagsplat.forces.config import ForcesConfig
from lagsplat.forces.grip import Grip, hold_of
from lagsplat.forces.held import Held
from lagsplat.forces.ray import Hit, cast
from lagsplat.forces.scene import scene_at

AHEAD, DOWN = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])
"""Along the film's line of sight, and down in its picture."""
FELT = 1e-3
"""Of a unit vector: what is left of it off the motion at least, so that there is a direction across."""


@dataclass(frozen=True)
class SpacePush:
    """A click, what it met, and the answers to forces of one ``size`` [energy per px at the pivot] on it.

    ``directions`` are unit vectors of space: x to the right, y down, z ahead of the film's camera. ``states``
    are the equilibria under no force, under the one across the motion and under the one downwards.
    """

    pixel: tuple[float, float]
    hit: Hit
    grip: Grip
    size: float
    directions: Float64[np.ndarray, "2 3"]
    states: Float64[np.ndarray, "3 d"]

    def numbers(self) -> dict[str, Any]:
        """What the figure is measured by, ready for JSON.

        ``felt_across`` is ``|J^T f|`` over ``|J| |f|``, ``pulled_across`` ``|J^T f|`` of the force itself.
        """
        across = torch.from_numpy(self.directions[0])
        pulled = float(self.grip.pull_back(across).norm())
        shifts = np.linalg.norm(self.states[1:] - self.states[0], axis=1)
        return {
            "pixel": self.pixel,
            "gaussian": self.hit.gaussian,
            "depth": self.hit.depth,
            "cover": self.hit.cover,
            "size": self.size,
            "across": self.directions[0].tolist(),
            "felt_across": pulled / float(torch.linalg.matrix_norm(self.grip.jacobian, 2)),
            "pulled_across": self.size * pulled,
            "shift_across": float(shifts[0]),
            "shift_down": float(shifts[1]),
            "state_down": self.states[2].tolist(),
        }


def push_in_space(held: Held, config: ForcesConfig) -> SpacePush:
    """Click where the film shows the largest motion up and down, and push there across the motion and down.

    Both forces are of the size that drives the state ``forces.response`` of the visited range downwards.

    Raises:
        ValueError: nothing moves up or down, or the state moves the matter in every direction of space.

    Source: paper, "Forces in three dimensions".
    """
    scene = scene_at(held.autoencoder, held.chart, held.rest.numpy())
    lever = np.where(scene.object, np.linalg.norm(scene.jacobian[:, :, 1], axis=2), 0.0)
    if not lever.any():
        raise ValueError("nothing moves up or down in the picture: there is nothing to push; check stage 1")
    row, column = np.unravel_index(int(lever.argmax()), lever.shape)
    pixel = (float(column) + 0.5, float(row) + 0.5)
    view = held.autoencoder.filmed_view(held.autoencoder.gaussians.center)
    hit = cast(held.autoencoder, held.chart, held.rest, view, pixel)
    grip = hold_of(held.kinematics, held.rest, hit.gaussian)
    directions = np.stack([across(grip.jacobian), DOWN])
    size = held.magnitude(grip, DOWN, share=config.response)
    loads = size * grip.pull_back(torch.from_numpy(directions))
    states = held.settled(torch.cat([torch.zeros(1, held.law.d, dtype=loads.dtype), loads]))
    return SpacePush(pixel, hit, grip, size, directions, states.numpy())


def across(jacobian: Float[Tensor, "3 d"]) -> Float64[np.ndarray, "3"]:
    """The direction in which the matter never moves, closest to the film's line of sight, or else to its
    horizontal.

    Raises:
        ValueError: the columns of the Jacobian span space.
    """
    ways = np.linalg.qr(jacobian.numpy())[0] if float(jacobian.abs().max()) > 0 else np.zeros((3, 1))
    for start in (AHEAD, np.array([1.0, 0.0, 0.0]), DOWN):
        left = start
        for _ in range(3):  # once is exact but for rounding, which the next ones take away
            left = left - ways @ (ways.T @ left)
        if (size := float(np.linalg.norm(left))) > FELT:
            return left / size
    raise ValueError(
        f"the {jacobian.shape[1]} coordinates move this matter in every direction of space: none is across"
    )
