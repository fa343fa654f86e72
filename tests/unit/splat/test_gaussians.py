"""The slice of the (n+d)-dimensional Gaussians, against the block formulas of the paper."""

import pytest
import torch

from lagsplat.splat.gaussians import Gaussians


def random_gaussians(n: int, d: int, space: int = 2) -> Gaussians:
    gaussians = Gaussians(n, d, space=space).double()
    with torch.no_grad():
        for parameter in gaussians.parameters():
            parameter.copy_(0.5 * torch.randn_like(parameter))
    return gaussians


def full_covariance(gaussians: Gaussians) -> torch.Tensor:
    """Sigma in the order latent, space, assembled from its Cholesky-like factor."""
    n, d, space = gaussians.n, gaussians.d, gaussians.space
    factor = torch.zeros(n, d + space, d + space, dtype=torch.float64)
    factor[:, :d, :d] = torch.linalg.inv(gaussians.precision_factor())
    factor[:, d:, :d] = gaussians.coupling
    for i in range(space):
        factor[:, d + i, d + i] = gaussians.shape_log_diagonal[:, i].exp()
        for j in range(i):
            factor[:, d + i, d + j] = gaussians.shape_below[:, i * (i - 1) // 2 + j]
    return factor @ factor.mT


@pytest.mark.parametrize("space", [2, 3])
@pytest.mark.parametrize("d", [1, 2, 4])
def test_slice_is_the_schur_complement(d, space):
    gaussians = random_gaussians(7, d, space)
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
    row, column = torch.tril_indices(space, space)
    torch.testing.assert_close(drawn.covariance, schur[:, row, column])
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
