import numpy as np
import torch

from lagsplat.chart.chart import Chart
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.stage2.decoder_mass import InducedMass, compute_decoder_geometry


def test_mass_is_the_presence_weighted_sum_of_the_decoders_jacobians() -> None:
    """In raw coordinates, straight from the Gaussians, the kinetic energy is the same number."""
    torch.manual_seed(0)
    autoencoder = Autoencoder(
        d=2, n_gaussians=15, kernel=4, channels=1, height=8, width=8, background="black", backend="torch"
    )
    gaussians = autoencoder.gaussians
    with torch.no_grad():
        gaussians.coupling.normal_()
        gaussians.latent_center.normal_()
        gaussians.opacity_logit.normal_()
        gaussians.precision_below.normal_()
    rng = np.random.default_rng(0)
    whiten = rng.normal(size=(2, 2)) + 2 * np.eye(2)
    mean = rng.normal(size=2)
    chart = Chart(
        mean=mean,
        whiten=whiten,
        unwhiten=np.linalg.inv(whiten),
        metric=np.eye(2),
        metric_scale=1.0,
        latents=np.zeros((4, 2)),
        inputs=np.zeros((4, 0)),
        time_s=np.arange(4.0),
        rest=np.zeros(2),
        n_train=3,
        segments=((0, 4),),
        smoothing_frames=0.0,
        condition=1.0,
        intrinsic_dimension=2.0,
        refinement_steps=0,
        visibility_step=2e-2,
    )
    mass = InducedMass(compute_decoder_geometry(autoencoder, chart), scale=3.0, floor=0.0)
    q, v = rng.normal(size=(2, 5, 2))
    energy = torch.einsum(
        "bi,bij,bj->b", torch.from_numpy(v), mass.matrix(torch.from_numpy(q)), torch.from_numpy(v)
    )
    z = torch.from_numpy(chart.to_raw(q)).float()
    with torch.no_grad():
        presence = gaussians.opacity_logit.sigmoid() * gaussians.gate(z)
        weight = presence / presence.sum(1, keepdim=True)
        moved = gaussians.jacobian() @ torch.from_numpy(v @ chart.unwhiten).float()[:, None, :, None]
        want = 3.0 * (weight * moved[..., 0].square().sum(-1)).sum(1)
    torch.testing.assert_close(energy.float(), want, rtol=1e-4, atol=1e-6)
