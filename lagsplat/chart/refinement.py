"""Latents at which the decoder draws the frames best.

An encoder answers with a state near the one that was filmed: beside its own noise, what a network of few
layers cannot say of a frame is missing. The decoder draws every state, so that the image decides what is
left: Gauss-Newton steps on the squared error of the drawing start from the encoder's answer.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.array_types import Images, Latents
from lagsplat.chart.visibility import Decode, differentiate_images

DAMPING = 1e-3  # of each step, relative to the image's change along each latent
LONGEST = 1.0  # step [deviations of the motion], beyond which the decoder is not linear


@torch.no_grad()
def refine_latents(decode: Decode, images: Images, q: Latents, *, steps: int, difference: float) -> Latents:
    """Move latents to where the decoder draws their images best.

    A step that draws an image worse is not taken, so that no latent gets worse.

    Args:
        decode: images at latents.
        images: one for each latent.
        q: latents to start from [whitened units].
        steps: Gauss-Newton steps.
        difference: step of the finite differences of the decoder [whitened units].
    """
    target = images.flatten(1).double()
    missing = target - decode(q).flatten(1).double()
    for _ in range(steps):
        slopes = differentiate_images(decode, q, difference)
        normal = slopes @ slopes.mT
        normal = normal + DAMPING * torch.diag_embed(normal.diagonal(dim1=1, dim2=2))
        step, info = torch.linalg.solve_ex(normal, slopes @ missing[:, :, None])
        step = step[:, :, 0].where(info[:, None] == 0, 0.0)
        after = q + step * (LONGEST / step.norm(dim=1, keepdim=True).clamp(min=LONGEST))
        still_missing = target - decode(after).flatten(1).double()
        better = _square_norm(still_missing) < _square_norm(missing)
        q, missing = after.where(better, q), still_missing.where(better, missing)
    return q


def _square_norm(x: Float[Tensor, "B P"]) -> Float[Tensor, "B 1"]:
    return x.square().sum(1, keepdim=True)
