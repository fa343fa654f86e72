"""The depth of what a recording shows, drawn from Gaussians of space."""

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.splat.projection import compute_depths
from lagsplat.stage1.autoencoder import Autoencoder

LEAST_COVER = 0.5  # share of the light of a pixel from which on matter shows


@torch.no_grad()
def draw_depth(autoencoder: Autoencoder, z: Float64[np.ndarray, " d"]) -> Float64[np.ndarray, "H W"]:
    """Depth of what each pixel of the recording shows at the raw latent ``z`` [px at the pivot].

    Compositing is linear, so the depths of the Gaussians replace their colours: it is a mean with the weights
    of these. NaN where Gaussians cover a pixel by less than half.
    """
    model = autoencoder.gaussians
    scene = model.condition(torch.from_numpy(z[None]).to(model.center))
    ahead = compute_depths(scene.means, autoencoder.filmed_view(scene.means))
    labels = torch.stack([ahead, torch.ones_like(ahead), torch.zeros_like(ahead)], dim=2)
    scene = scene._replace(color=labels, background=torch.zeros_like(scene.background))
    depth, cover, _ = autoencoder.draw(scene)[0].double().cpu()
    return (depth / cover).where(cover >= LEAST_COVER, torch.nan).numpy()
