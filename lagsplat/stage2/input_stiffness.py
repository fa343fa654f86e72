"""How the stiffness of a mechanism depends on its inputs: second derivatives of the chamber volumes."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor, nn

from lagsplat.array_types import Inputs, Latents

SMALLEST = 1e-4  # smallest eigenvalue of each part of a curvature, so that its factor still has a gradient
SIGNED = 1e-2
"""Share of an input's largest value that it must reach below zero to count as signed; smoothing overshoots,
and a gauge reads slightly below zero at rest."""


@dataclass(frozen=True)
class InputRange:
    """Largest positive and largest negative size of each input; the latter is 0 for an input of one sign."""

    positive: Float[Tensor, " n_u"]
    negative: Float[Tensor, " n_u"]

    @property
    def signed(self) -> bool:
        """Whether any input takes negative values."""
        return bool((self.negative > 0).any())


def measure_input_range(inputs: Float64[np.ndarray, "T n_u"]) -> InputRange:
    """Measure the range of the inputs of a clip."""
    largest, smallest = (torch.from_numpy(end) for end in (inputs.max(0), inputs.min(0)))
    negative = (-smallest).clamp(min=0.0)
    return InputRange(largest.clamp(min=0.0), negative.where(negative > SIGNED * largest.abs(), 0.0))


@dataclass(frozen=True)
class InputStiffness:
    """How much a unit of each input stiffens and softens, as positive semidefinite matrices.

    ``input_range`` is the range of inputs for which there is to be one equilibrium.
    """

    stiffer: Float[Tensor, "n_u d d"]
    softer: Float[Tensor, "n_u d d"]
    input_range: InputRange

    @property
    def curvature(self) -> Float[Tensor, "n_u d d"]:
        """Stiffness per unit of each input."""
        return self.stiffer - self.softer


class InputStiffnessPrior(nn.Module):
    """``Q_c = R_c R_c^T - P_c P_c^T`` for each input ``c``: the volumes are ``B x - x.Q x / 2``.

    A positive input stiffens by ``R`` and softens by ``P``, a negative one the other way round. A constant
    stiffness ``sum_c u_max,c P_c P_c^T + |u_min,c| R_c R_c^T`` compensates the softening, so that every load
    ``u_min <= u <= u_max`` has one equilibrium, with ``u_min = 0`` for inputs of one sign. Without ``P`` and
    without negative inputs the volumes are concave, and that holds under any load.
    """

    largest_input: Tensor
    largest_negative: Tensor | None

    def __init__(self, input_stiffness: InputStiffness, *, softening: bool) -> None:
        super().__init__()
        values, vectors = torch.linalg.eigh(input_stiffness.curvature)
        stiffening, softer = _factor(values, vectors), _factor(-values, vectors)
        # A common part of both cancels in the curvature. An input of one sign drops it, which needs the least
        # compensation; a signed one keeps it, because the stiffness was fitted together with it.
        signed = (input_stiffness.input_range.negative > 0)[:, None, None]
        stiffening = torch.where(signed, _factor(*torch.linalg.eigh(input_stiffness.stiffer)), stiffening)
        softer = torch.where(signed, _factor(*torch.linalg.eigh(input_stiffness.softer)), softer)
        ends = input_stiffness.input_range
        self.register_buffer("largest_input", ends.positive.clone())
        self.register_buffer("largest_negative", ends.negative.clone() if ends.signed else None)
        self.stiffening = nn.Parameter(stiffening)
        self.softening = nn.Parameter(softer) if softening else None

    def matrices(self) -> tuple[Float[Tensor, "n_u d d"], Float[Tensor, "d d"]]:
        """Compute the curvatures and the stiffness that compensates the softening."""
        stiffer = self.stiffening @ self.stiffening.mT
        curvature, compensation = stiffer, stiffer.new_zeros(stiffer.shape[1:])
        if self.softening is not None:
            softer = self.softening @ self.softening.mT
            curvature, compensation = stiffer - softer, stiffness_penalty(softer, self.largest_input)
        if self.largest_negative is not None:
            compensation = compensation + stiffness_penalty(stiffer, self.largest_negative)
        return curvature, compensation


def stiffness_penalty(softer: Float[Tensor, "n_u d d"], largest: Float[Tensor, " n_u"]) -> Tensor:
    """Compute the stiffness (d, d) that the largest inputs of one sign remove together."""
    return (largest[:, None, None] * softer).sum(0)


def stiffen(u: Inputs, curvature: Float[Tensor, "n_u d d"], offset: Latents) -> Latents:
    """Compute ``sum_c u_c Q_c offset`` for each sample."""
    matrices = (u @ curvature.flatten(1)).view(-1, *curvature.shape[1:])
    return (matrices @ offset[:, :, None])[:, :, 0]


def _factor(values: Tensor, vectors: Tensor) -> Tensor:
    return vectors * values.clamp(min=SMALLEST).sqrt()[..., None, :]
