"""The terms of the reconstruction loss, against independent formulas."""

import numpy as np
import pytest
import torch
from skimage.metrics import structural_similarity

from lagsplat.splat.losses import anisotropy, nonlocal_filter, structural_dissimilarity


def test_ssim_agrees_with_scikit_image():
    rng = np.random.default_rng(0)
    a, b = rng.random((2, 3, 20, 28)).astype(np.float32)
    b = 0.7 * a + 0.3 * b
    ours = structural_dissimilarity(torch.as_tensor(a[None]), torch.as_tensor(b[None]), window=11)
    theirs = structural_similarity(
        a, b, channel_axis=0, data_range=1, gaussian_weights=True, sigma=1.5, use_sample_covariance=False
    )  # its Gaussian window is 11 wide, and the border is left out of the mean
    assert float(ours) == pytest.approx(1 - theirs, abs=1e-5)


def test_ssim_of_equal_images_is_one():
    image = torch.rand(2, 3, 9, 12)
    assert float(structural_dissimilarity(image, image, window=7)) == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("shape", [(1, 1), (2, 5), (4, 3)])
def test_ssim_window_shrinks_to_a_small_image(shape):
    a, b = torch.rand(2, 1, 3, *shape)
    assert torch.isfinite(structural_dissimilarity(a, b, window=7))


def test_anisotropy_counts_only_beyond_the_limit():
    covariance = torch.tensor([[4.0, 0.0, 1.0], [100.0, 0.0, 1.0], [1.0, 0.0, 1.0]], requires_grad=True)
    value = anisotropy(covariance, limit=5.0)
    assert value.item() == pytest.approx(np.log(10 / 5) / 3, rel=1e-5)
    value.backward()
    assert torch.isfinite(covariance.grad).all()
    assert covariance.grad[0].abs().sum() == 0
    assert covariance.grad[1].abs().sum() > 0


def test_anisotropy_does_not_depend_on_the_orientation():
    angle = torch.tensor(0.7)
    rotation = torch.stack(
        (torch.stack((angle.cos(), -angle.sin())), torch.stack((angle.sin(), angle.cos())))
    )
    turned = rotation @ torch.diag(torch.tensor([100.0, 1.0])) @ rotation.T
    rows = torch.stack((turned[0, 0], turned[0, 1], turned[1, 1]))[None]
    assert anisotropy(rows, limit=5.0).item() == pytest.approx(np.log(2), rel=1e-3)


def test_anisotropy_of_ellipsoids_is_that_of_their_eigenvalues():
    factor = torch.randn(50, 3, 3, dtype=torch.float64) * torch.tensor([8.0, 1.0, 0.2])
    full = factor @ factor.mT
    row, column = torch.tril_indices(3, 3)
    values = torch.linalg.eigvalsh(full)
    expected = torch.relu(0.5 * (values[:, 2] / values[:, 0]).log() - np.log(5.0)).mean()
    assert expected > 0.5
    torch.testing.assert_close(anisotropy(full[:, row, column], limit=5.0), expected, rtol=1e-5, atol=0)


@pytest.mark.parametrize("axes", [(2.0, 2.0, 2.0), (900.0, 1.0, 1.0), (900.0, 900.0, 1.0)])
def test_equal_axes_of_an_ellipsoid_give_finite_gradients(axes):
    xx, yy, zz = axes
    covariance = torch.tensor([[xx, 0.0, yy, 0.0, 0.0, zz]], requires_grad=True)
    value = anisotropy(covariance, limit=5.0)
    assert value.item() == pytest.approx(max(0.0, np.log(max(axes) / min(axes)) / 2 - np.log(5)), abs=1e-2)
    value.backward()
    assert covariance.grad.isfinite().all()
    assert covariance.grad.abs().max() < 10


def test_nonlocal_penalty_is_the_double_sum():
    bank = torch.randn(2, 3, 4, 4, dtype=torch.float64)
    place = torch.stack(torch.meshgrid(torch.arange(4.0), torch.arange(4.0), indexing="ij"), -1).reshape(
        -1, 2
    )
    kernel = torch.exp(-(torch.cdist(place, place).double() ** 2))
    taps = bank.flatten(0, 1).flatten(1)
    expected = 0.5 * (kernel * (taps[:, :, None] - taps[:, None, :]) ** 2).sum()
    torch.testing.assert_close(nonlocal_filter([bank]), expected, rtol=1e-6, atol=1e-9)


def test_nonlocal_penalty_of_a_flat_filter_is_zero():
    assert nonlocal_filter([torch.ones(1, 1, 12, 12)]).item() == pytest.approx(0, abs=1e-3)
