"""How the stiffness of a mechanism depends on its inputs: second derivatives of the chamber volumes."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor, nn

from lagsplat.array_types import Inputs, Latents

SMALLEST = 1e-4
"""Eigenvalue that a part of a curvature keeps, so that its factor can still move."""


SIGNED = 1e-2
"""Of an input's largest size: what it must reach below zero to count as signed. Smoothing overshoots, and a
gauge reads a little below zero at rest."""


@dataclass(frozen=True)
class InputRange:
    """Sizes of the largest positive and of the largest negative inputs; the latter 0 for one of one sign."""

    positive: Float[Tensor, " n_u"]
    negative: Float[Tensor, " n_u"]

    @property
    def signed(self) -> bool:
        """Whether an input takes both signs, or negative values only."""
        return bool((self.negative > 0).any())


def measure_input_range(inputs: Float64[np.ndarray, "T n_u"]) -> InputRange:
    """How far the inputs of a clip go either way."""
    largest, smallest = (torch.from_numpy(end) for end in (inputs.max(0), inputs.min(0)))
    negative = (-smallest).clamp(min=0.0)
    return InputRange(largest.clamp(min=0.0), negative.where(negative > SIGNED * largest.abs(), 0.0))


@dataclass(frozen=True)
class InputStiffness:
    """By how much a unit of each input stiffens and softens, both positive semidefinite, and up to which
    inputs there is to be one equilibrium.
    """

    stiffer: Float[Tensor, "n_u d d"]
    softer: Float[Tensor, "n_u d d"]
    input_range: InputRange

    @property
    def curvature(self) -> Float[Tensor, "n_u d d"]:
        """What a unit of each input adds to the stiffness."""
        return self.stiffer - self.softer


class InputStiffnessPrior(nn.Module):
    """``Q_c = R_c R_c^T - P_c P_c^T`` for each input ``c``: the volumes are ``B x - x.Q x / 2``.

    An input stiffens by ``R`` and softens by ``P``; a negative one the other way round. What is softened is
    paid for by a stiffness of its own, ``sum_c u_max,c P_c P_c^T + |u_min,c| R_c R_c^T``, so that every load
    ``u_min <= u <= u_max`` has one equilibrium, with ``u_min = 0`` for inputs of one sign. Without ``P`` and
    without negative inputs the volumes are concave, and that holds under any load.
    """

    largest_input: Tensor
    largest_negative: Tensor | None

    def __init__(self, input_stiffness: InputStiffness, *, softening: bool) -> None:
        super().__init__()
        values, vectors = torch.linalg.eigh(input_stiffness.curvature)
        stiffening, softer = _factor(values, vectors), _factor(-values, vectors)
        # What stiffens and softens alike cancels in the curvature. An input of one sign does without, at the
        # least payment; a signed one keeps it, because the stiffness beside it was fitted together with it.
        signed = (input_stiffness.input_range.negative > 0)[:, None, None]
        stiffening = torch.where(signed, _factor(*torch.linalg.eigh(input_stiffness.stiffer)), stiffening)
        softer = torch.where(signed, _factor(*torch.linalg.eigh(input_stiffness.softer)), softer)
        self.register_buffer("largest_input", input_stiffness.input_range.positive.clone())
        self.register_buffer(
            "largest_negative",
            input_stiffness.input_range.negative.clone() if input_stiffness.input_range.signed else None,
        )
        self.stiffening = nn.Parameter(stiffening)
        self.softening = nn.Parameter(softer) if softening else None

    def matrices(self) -> tuple[Float[Tensor, "n_u d d"], Float[Tensor, "d d"]]:
        """The curvatures, and the stiffness that pays for what the inputs soften."""
        stiffer = self.stiffening @ self.stiffening.mT
        curvature, compensation = stiffer, stiffer.new_zeros(stiffer.shape[1:])
        if self.softening is not None:
            softer = self.softening @ self.softening.mT
            curvature, compensation = stiffer - softer, stiffness_penalty(softer, self.largest_input)
        if self.largest_negative is not None:
            compensation = compensation + stiffness_penalty(stiffer, self.largest_negative)
        return curvature, compensation


def stiffness_penalty(
    softer: Float[Tensor, "n_u d d"], largest_input: Float[Tensor, " n_u"]
) -> Float[Tensor, "d d"]:
    """The stiffness that the largest inputs of one sign together take away."""
    return (largest_input[:, None, None] * softer).sum(0)


def stiffen(u: Inputs, curvature: Float[Tensor, "n_u d d"], offset: Latents) -> Latents:
    """``sum_c u_c Q_c offset``, sample by sample."""
    matrices = (u @ curvature.flatten(1)).view(-1, *curvature.shape[1:])
    return (matrices @ offset[:, :, None])[:, :, 0]


def _factor(values: Tensor, vectors: Tensor) -> Tensor:
    return vectors * values.clamp(min=SMALLEST).sqrt()[..., None, :]
