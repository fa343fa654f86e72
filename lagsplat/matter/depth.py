"""The depth of what a recording shows, drawn from Gaussians of space."""

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.stage1.training_data import composite_depths

LEAST_COVER = 0.5  # share of the light of a pixel from which on matter shows


@torch.no_grad()
def draw_depth(autoencoder: Autoencoder, z: Float64[np.ndarray, " d"]) -> Float64[np.ndarray, "H W"]:
    """Depth of what each pixel of the recording shows at the raw latent ``z`` [px at the pivot].

    It is a mean with the weights of the colours. NaN where Gaussians cover a pixel by less than half.
    """
    latent = torch.from_numpy(z[None]).to(autoencoder.gaussians.center)
    drawn = composite_depths(autoencoder, latent, autoencoder.filmed_view(latent))
    depth, cover = (part[0].double().cpu() for part in drawn)
    return (depth / cover).where(cover >= LEAST_COVER, torch.nan).numpy()
