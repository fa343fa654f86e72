"""How the stiffness of a mechanism depends on its inputs: second derivatives of the chamber volumes."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from lagsplat.shapes import Inputs, Latents

SMALLEST = 1e-4
"""Eigenvalue that a part of a curvature keeps, so that its factor can still move."""


class Curvature(nn.Module):
    """``Q_c = R_c R_c^T - P_c P_c^T`` for each input ``c``: the volumes are ``B x - x.Q x / 2``.

    An input stiffens by ``R`` and softens by ``P``. The softening is paid for by a stiffness of its own,
    ``sum_c u_max,c P_c P_c^T``, so that every load ``0 <= u <= u_max`` has one equilibrium. Without ``P`` the
    volumes are concave, and that holds under any load.
    """

    largest_input: Tensor

    def __init__(
        self,
        curvature: Float[Tensor, "n_u d d"],
        largest_input: Float[Tensor, " n_u"],
        *,
        softening: bool,
    ) -> None:
        super().__init__()
        values, vectors = torch.linalg.eigh(curvature)
        self.register_buffer("largest_input", largest_input.clone())
        self.stiffening = nn.Parameter(_factor(values, vectors))
        self.softening = nn.Parameter(_factor(-values, vectors)) if softening else None

    def matrices(self) -> tuple[Float[Tensor, "n_u d d"], Float[Tensor, "d d"]]:
        """The curvatures, and the stiffness that pays for the softening ones."""
        curvature = self.stiffening @ self.stiffening.mT
        if self.softening is None:
            return curvature, torch.zeros_like(curvature[0])
        softer = self.softening @ self.softening.mT
        return curvature - softer, payment(softer, self.largest_input)


def payment(softer: Float[Tensor, "n_u d d"], largest_input: Float[Tensor, " n_u"]) -> Float[Tensor, "d d"]:
    """The stiffness that the largest inputs together take away."""
    return (largest_input[:, None, None] * softer).sum(0)


def stiffened(u: Inputs, curvature: Float[Tensor, "n_u d d"], offset: Latents) -> Latents:
    """``sum_c u_c Q_c offset``, sample by sample."""
    matrices = (u @ curvature.flatten(1)).view(-1, *curvature.shape[1:])
    return (matrices @ offset[:, :, None])[:, :, 0]


def _factor(values: Tensor, vectors: Tensor) -> Tensor:
    return vectors * values.clamp(min=SMALLEST).sqrt()[..., None, :]
