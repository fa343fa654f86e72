"""What the decoder tells the dynamics about its own kinematics."""

import torch

from lagsplat.chart.chart import Chart
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.stage2.induced import DecoderGeometry, whitened_geometry


@torch.no_grad()
def decoder_geometry(autoencoder: Autoencoder, chart: Chart) -> DecoderGeometry:
    """The Gaussians' Jacobians, centres and gates in the whitened coordinates of ``chart``.

    Source: paper, Appendix, decoder-induced mass.
    """
    gaussians = autoencoder.gaussians.cpu()
    return whitened_geometry(
        gaussians.jacobian(),
        gaussians.latent_center,
        gaussians.precision_factor(),
        gaussians.opacity_logit.sigmoid(),
        mean=torch.from_numpy(chart.mean),
        whiten=torch.from_numpy(chart.whiten),
        unwhiten=torch.from_numpy(chart.unwhiten),
    )
