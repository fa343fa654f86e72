"""The slice of the (2+d)-dimensional Gaussians, against the block formulas of the paper."""

import pytest
import torch

from lagsplat.splat.gaussians import Gaussians


def random_gaussians(n: int, d: int) -> Gaussians:
    gaussians = Gaussians(n, d).double()
    with torch.no_grad():
        for parameter in gaussians.parameters():
            parameter.copy_(0.5 * torch.randn_like(parameter))
    return gaussians


def full_covariance(gaussians: Gaussians) -> torch.Tensor:
    """Sigma in the order (z, x, y), assembled from its Cholesky-like factor."""
    n, d = gaussians.n, gaussians.d
    factor = torch.zeros(n, d + 2, d + 2, dtype=torch.float64)
    factor[:, :d, :d] = torch.linalg.inv(gaussians.precision_factor())
    factor[:, d:, :d] = gaussians.coupling
    factor[:, d, d], factor[:, d + 1, d + 1] = gaussians.shape_log_diagonal.exp().unbind(1)
    factor[:, d + 1, d] = gaussians.shape_below
    return factor @ factor.mT


@pytest.mark.parametrize("d", [1, 2, 4])
def test_slice_is_the_schur_complement(d):
    gaussians = random_gaussians(7, d)
    z = torch.randn(3, d, dtype=torch.float64)
    with torch.no_grad():
        sigma = full_covariance(gaussians)
        drawn = gaussians.condition(z)
        gain = sigma[:, d:, :d] @ torch.linalg.inv(sigma[:, :d, :d])
        offset = z[:, None] - gaussians.latent_center
        means = gaussians.center + (gain @ offset[..., None])[..., 0]
        schur = sigma[:, d:, d:] - gain @ sigma[:, :d, d:]
        distance = (offset[..., None, :] @ torch.linalg.inv(sigma[:, :d, :d]) @ offset[..., None])[..., 0, 0]
    torch.testing.assert_close(drawn.means, means)
    torch.testing.assert_close(
        drawn.covariance, torch.stack((schur[:, 0, 0], schur[:, 0, 1], schur[:, 1, 1]), 1)
    )
    torch.testing.assert_close(drawn.opacity, gaussians.opacity_logit.sigmoid() * torch.exp(-distance / 2))
    torch.testing.assert_close(gaussians.jacobian(), gain)


def test_the_mean_moves_by_its_jacobian():
    gaussians = random_gaussians(5, 3)
    z = torch.randn(1, 3, dtype=torch.float64)
    step = torch.randn(1, 3, dtype=torch.float64)
    moved = gaussians.condition(z + step).means - gaussians.condition(z).means
    torch.testing.assert_close(moved[0], (gaussians.jacobian() @ step[0, :, None])[..., 0])


def test_black_background_is_not_a_parameter():
    gaussians = Gaussians(2, 1, background="black")
    assert "background_logit" not in dict(gaussians.named_parameters())
    assert gaussians.condition(torch.zeros(1, 1)).background.tolist() == [0, 0, 0]
