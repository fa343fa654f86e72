"""The differenced visibility metric against exact derivatives."""

import numpy as np
import pytest
import torch
from torch import Tensor

from lagsplat.chart.visibility import Decode, measure_visibility
from lagsplat.splat.gaussians import Gaussians
from lagsplat.splat.image_model import rasterize


def exact_gram(decode: Decode, q: np.ndarray) -> np.ndarray:
    """The metric times its scale, by reverse-mode differentiation of one image at a time."""
    total = np.zeros((q.shape[1], q.shape[1]))
    for row in torch.from_numpy(q):
        slope = torch.autograd.functional.jacobian(lambda x: decode(x[None])[0].double().flatten(), row)
        total += (slope.T @ slope).numpy() / len(q)
    return total


def curved(q: Tensor) -> Tensor:
    """A picture of two pixels that bends with both coordinates."""
    value = torch.stack([torch.sin(q[:, 0]), q[:, 1] * q[:, 0], 3.0 * q[:, 1]], 1)
    return value[:, :, None, None]


def test_differences_agree_with_automatic_differentiation() -> None:
    q = np.random.default_rng(0).normal(size=(40, 2))
    got, exact = measure_visibility(curved, q, step=1e-2), exact_gram(curved, q)
    np.testing.assert_allclose(got.metric * got.scale, exact, rtol=1e-7)
    assert np.trace(got.metric) == pytest.approx(2.0)
    assert got.condition == pytest.approx(np.linalg.cond(exact), rel=1e-6)


def test_differences_of_the_rasteriser_agree_with_its_gradient() -> None:
    gaussians = Gaussians(40, 2)
    with torch.no_grad():
        generator = torch.Generator().manual_seed(0)
        gaussians.center.uniform_(2, 14, generator=generator)
        gaussians.latent_center.normal_(generator=generator)
        gaussians.coupling.normal_(generator=generator)
        gaussians.color_logit.normal_(generator=generator)
        gaussians.shape_log_diagonal.fill_(0.8)
        gaussians.precision_log_diagonal.fill_(-0.7)

    def decode(q: Tensor) -> Tensor:
        return rasterize(*gaussians.condition(q.float()), height=16, width=16)

    q = np.random.default_rng(0).normal(size=(6, 2))
    got, exact = measure_visibility(decode, q, step=0.1), exact_gram(decode, q)
    scale = np.trace(exact) / 2
    np.testing.assert_allclose(got.metric, exact / scale, atol=0.02)
    assert got.scale == pytest.approx(scale, rel=0.03)


def test_a_flickering_or_silent_picture_is_refused() -> None:
    noise = torch.Generator().manual_seed(0)
    with pytest.raises(ValueError, match="visibility_step"):
        measure_visibility(
            lambda q: torch.rand(len(q), 3, 2, 2, generator=noise), np.zeros((8, 2)), step=1e-2
        )
    with pytest.raises(ValueError, match="no latent direction"):
        measure_visibility(lambda q: torch.zeros(len(q), 3, 2, 2), np.zeros((8, 2)), step=1e-2)
