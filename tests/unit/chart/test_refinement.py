"""Latents refined by a decoder that is known."""

import numpy as np
import torch

from lagsplat.chart.refinement import refine_latents


def draw(q: torch.Tensor) -> torch.Tensor:
    """A blob at a place that bends with two latents, as images (B, 3, 9, 9)."""
    y, x = torch.meshgrid(*[torch.linspace(-2, 2, 9, dtype=torch.float64)] * 2, indexing="ij")
    at = q[:, :, None, None] + 0.1 * q[:, :, None, None] ** 2
    blob = torch.exp(-((x - at[:, 0]) ** 2) - (y - at[:, 1]) ** 2)
    return blob[:, None].expand(-1, 3, -1, -1).contiguous()


def test_steps_find_the_latents_of_the_images() -> None:
    true = torch.from_numpy(np.random.default_rng(0).uniform(-1, 1, (20, 2)))
    start = true + 0.2
    errors = [
        float((refine_latents(draw, draw(true).float(), start, steps=n, difference=1e-3) - true).abs().max())
        for n in (0, 1, 3)
    ]
    assert errors[0] > 4.0 * errors[1] > 40.0 * errors[2]


def test_noise_of_the_images_moves_latents_as_least_squares_say() -> None:
    rng = np.random.default_rng(1)
    true = torch.from_numpy(np.repeat([[0.3, -0.2]], 400, axis=0))
    seen = (draw(true) + 0.02 * torch.from_numpy(rng.standard_normal((400, 3, 9, 9)))).float()
    found = refine_latents(draw, seen, true + 0.05, steps=3, difference=1e-3)
    slopes = [
        (draw(true[:1] + h) - draw(true[:1] - h)).flatten() / 2e-3 for h in 1e-3 * torch.eye(2).double()
    ]
    jacobian = torch.stack(slopes, 1)
    expected = 0.02 * torch.linalg.inv(jacobian.T @ jacobian).diagonal().sqrt()
    torch.testing.assert_close(found.std(0), expected, rtol=0.15, atol=0.0)


def test_a_latent_is_not_moved_where_the_image_gets_worse() -> None:
    images = draw(torch.tensor([[0.5, 0.5], [0.0, 0.0]]).double()).float()
    start = torch.tensor([[0.5, 0.5], [40.0, 40.0]]).double()  # the best there is, and where nothing is drawn
    found = refine_latents(draw, images, start, steps=2, difference=1e-3)
    torch.testing.assert_close(found[0], start[0], rtol=0.0, atol=1e-6)
    assert torch.isfinite(found).all()
    assert float((found[1] - start[1]).norm()) <= 2.0  # no step is longer than one
