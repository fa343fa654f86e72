"""A free linear map of state and velocity: the Koopman baseline."""

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from lagsplat.shapes import Inputs, Latents

HIDDEN = 16


class Koopman(nn.Module):
    """``y -> A y + h(u)`` on ``y = (z, v)``, once a frame.

    Nothing ties ``v`` to the derivative of ``z``, and there is no force in it: what is added to ``y`` is an
    increment of the state, of which ``A`` gives no mechanical reading.
    """

    def __init__(self, d: int, *, n_inputs: int) -> None:
        super().__init__()
        self.d = d
        self.matrix = nn.Parameter(torch.eye(2 * d))
        self.increment = nn.ModuleList([nn.Linear(n_inputs, HIDDEN), nn.Linear(HIDDEN, 2 * d)])

    def input_force(self, u: Inputs) -> Float[Tensor, "B n"]:
        """``h(u)``, of the delayed inputs, n = 2 d."""
        first, last = self.increment
        return last(functional.leaky_relu(first(u)))

    def forward(self, z: Latents, v: Latents, u: Inputs) -> tuple[Latents, Latents]:
        """State and the second half of ``y`` a frame later."""
        later = torch.cat([z, v], 1) @ self.matrix.T + self.input_force(u)
        return later[:, : self.d], later[:, self.d :]

    def transition(self) -> Float[Tensor, "n n"]:
        """``A``, n = 2 d."""
        return self.matrix
