"""How far away what a pixel shows is."""

import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.shapes import Latents
from lagsplat.splat.projection import View, depths
from lagsplat.stage1.autoencoder import Autoencoder

FAINT = 1e-3
"""Cover below which a pixel shows the background, which is nowhere."""


@torch.no_grad()
def seen_depth(autoencoder: Autoencoder, z: Latents, view: View) -> Float[Tensor, "B H W"]:
    """Mean depth of what each camera sees in each pixel [unit of space], weighted as its colour is.

    Compositing is linear in the colours, so depths are drawn in their place. Where nothing is, the depth is
    that of the pivot.
    """
    scene = autoencoder.gaussians.condition(z)
    ahead = depths(scene.means, view)
    told = torch.stack([ahead, torch.ones_like(ahead), torch.zeros_like(ahead)], dim=2)
    drawn = autoencoder.draw(
        scene._replace(color=told, background=torch.zeros_like(scene.background)), view=view
    )
    pivot = autoencoder.filmed_view(z).focal[0, 0]
    return torch.where(drawn[:, 1] > FAINT, drawn[:, 0] / drawn[:, 1].clamp_min(FAINT), pivot)
