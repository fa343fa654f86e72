"""The hand: a drag in the picture as a force on the matter that was grasped."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.forces.equilibrium import stiffness
from lagsplat.forces.grip import Grip, NothingThereError, Place, Point, brush, hold_of
from lagsplat.forces.held import Held
from lagsplat.forces.scene import STILL

OBJECT = 0.5
"""Of the largest motion: Gaussians that move as much decide how strong a drag is."""
PRESENT = 0.1
LARGEST = 0.98
"""The quantile of the motions that counts as the largest."""
WEAKEST = 1e-6
"""Of the largest stiffness: what is softer, or unstable, is taken to be as stiff as this."""


@dataclass(frozen=True)
class Hand:
    """What holds the matter of ``grip`` with ``force`` [energy of the law per px]: right, down and, in
    space, ahead of the film's camera.

    ``still`` says that the matter grasped there hardly moves with any coordinate: it is background.
    """

    grip: Grip
    force: Float64[np.ndarray, " n"]
    still: bool

    @property
    def load(self) -> Float64[np.ndarray, " d"]:
        """The generalised force."""
        return self.force @ self.grip.jacobian.numpy()

    def place(self, q: Float64[np.ndarray, " d"]) -> Float64[np.ndarray, " n"]:
        """Where the matter is now [px]."""
        return self.grip.place(torch.from_numpy(q)).numpy()


class Touch:
    """How a picture is touched: the width of the brush, and how much force a pixel of drag is worth.

    ``gain`` [energy per px^2] is such that a drag of ``drag_px`` on the object drives the state
    ``response`` of the visited range away from rest, by the stiffness there.
    """

    def __init__(self, held: Held, *, radius_px: float, drag_px: float, response: float) -> None:
        self.kinematics, self.radius_px = held.kinematics, radius_px
        present = held.kinematics.presence(held.rest[None])[0] > PRESENT
        jacobian = held.kinematics.geometry.jacobian
        motion = jacobian.flatten(1).norm(dim=1)
        shown = motion[present] if bool(present.any()) else motion
        self.motion = float(shown.quantile(LARGEST))
        # ties and a decoder of few Gaussians must leave at least one of them
        chosen = jacobian[present & (motion >= OBJECT * self.motion)]
        chosen = chosen if len(chosen) else jacobian[motion.argmax()][None]
        values, vectors = torch.linalg.eigh(stiffness(held.law, held.rest[None], held.u[None])[0])
        values = values.abs().clamp(min=WEAKEST * float(values.abs().max()))
        compliance = (vectors / values) @ vectors.T
        answers = torch.linalg.matrix_norm(chosen @ compliance, ord=2)
        self.gain = response * held.reach / (float(answers.median()) * drag_px)

    def grasp(self, q: Float64[np.ndarray, " d"], at: Point | Place, *, met: int | None = None) -> Hand:
        """Take hold of the matter around ``at`` [px] at the state ``q``, without pulling yet.

        Of the Gaussian ``met`` alone where no centre is under the brush, and one was met.

        Raises:
            ValueError: as `lagsplat.forces.grip.brush`.
        """
        state = torch.from_numpy(q)
        try:
            grip = brush(self.kinematics, state, at, radius=self.radius_px)
        except NothingThereError:
            if met is None:
                raise
            grip = replace(hold_of(self.kinematics, state, met), at=torch.tensor(at, dtype=torch.float64))
        still = float(grip.jacobian.norm()) < STILL * self.motion
        return Hand(grip, np.zeros(self.kinematics.space), still)
