"""The rasterisers against each other: a naive loop, the torch specification, the Numba kernels, gsplat."""

import math
from itertools import pairwise

import pytest
import torch
from torch import Tensor

from lagsplat.splat.gaussians import GaussianSlice
from lagsplat.splat.image_model import evaluate_alphas, rasterize
from lagsplat.splat.rasterize_gsplat import TILE_PX, embed_in_space


def random_scene(batch, count, height, width, *, sigma=1.7, opacity=(0.02, 0.9), margin=3.0, seed=0):
    """Means, covariance, opacity, color, background in float32; centres may lie outside by ``margin`` px."""
    generator = torch.Generator().manual_seed(seed)

    def uniform(*shape, low=0.0, high=1.0):
        return low + (high - low) * torch.rand(*shape, generator=generator)

    size = torch.tensor([width, height]) + 2 * margin
    means = uniform(batch, count, 2) * size - margin
    scale = sigma * uniform(count, 2, low=0.6, high=1.4)
    correlation = uniform(count, low=-0.8, high=0.8)
    covariance = torch.stack([scale[:, 0] ** 2, correlation * scale.prod(1), scale[:, 1] ** 2], 1)
    return (
        means,
        covariance,
        uniform(batch, count, low=opacity[0], high=opacity[1]),
        uniform(count, 3),
        uniform(3),
    )


SCENES = {
    "usual": (random_scene(3, 120, 32, 32), 32, 32),
    "one pixel": (random_scene(2, 5, 1, 1, margin=1.0), 1, 1),
    "one Gaussian, one image": (random_scene(1, 1, 9, 7, margin=-3.0), 9, 7),
    "wide, several tiles": (random_scene(2, 150, 21, 83), 21, 83),
    "tall, several tiles": (random_scene(1, 150, 70, 33), 70, 33),
    "opaque stack": (random_scene(2, 300, 20, 20, sigma=4.0, opacity=(0.7, 1.0)), 20, 20),
    "mostly outside": (random_scene(2, 80, 16, 16, margin=20.0), 16, 16),
    "long, cut by tiles": (random_scene(2, 60, 70, 83, sigma=9.0, opacity=(0.5, 0.95)), 70, 83),
    "huge": (random_scene(2, 30, 40, 40, sigma=60.0), 40, 40),
    "tiny": (random_scene(2, 100, 24, 24, sigma=1e-3), 24, 24),
}


def images_and_gradients(backend, scene, height, width, dtype, device="cpu") -> tuple[Tensor, list[Tensor]]:
    inputs = [tensor.to(dtype).requires_grad_() for tensor in scene]
    images = rasterize(
        *(part.to(device) for part in inputs), height=height, width=width, backend=backend
    ).cpu()
    weight = torch.randn(images.shape, generator=torch.Generator().manual_seed(1))
    gradients = torch.autograd.grad((images * weight).sum(), inputs)
    return images.detach(), list(gradients)


def assert_gradients_agree(found, expected, *, relative=1e-3):
    names = ("means", "covariance", "opacity", "color", "background")
    for name, mine, reference in zip(names, found, expected, strict=True):
        scale = reference.abs().max().clamp(min=1e-6)
        assert ((mine - reference).abs().max() / scale) < relative, name
        assert (mine - reference).norm() <= relative * reference.norm() + 1e-6, name


@pytest.mark.parametrize("name", SCENES)
def test_numba_agrees_with_the_specification(name):
    scene, height, width = SCENES[name]
    images, gradients = images_and_gradients("numba", scene, height, width, torch.float32)
    reference, expected = images_and_gradients("torch", scene, height, width, torch.float64)
    assert images.dtype == torch.float32
    assert images.shape == reference.shape == (len(scene[0]), 3, height, width)
    torch.testing.assert_close(images.double(), reference, atol=1e-4, rtol=0)
    assert_gradients_agree(gradients, expected)


def test_the_opaque_scene_does_stop_pixels():
    scene, height, width = SCENES["opaque stack"]
    alpha = evaluate_alphas(scene[0][0], scene[1], scene[2][0], height, width)
    assert (torch.cumprod(1 - alpha, 0)[-1] <= 1e-4).float().mean() > 0.5


def naive(means, covariance, opacity, color, background, *, height, width):
    """One pixel after the other, one Gaussian after the other, with Python's numbers."""
    images = torch.zeros(len(means), 3, height, width, dtype=torch.float64)
    for b in range(len(means)):
        for i in range(height):
            for j in range(width):
                transmittance, light = 1.0, [0.0, 0.0, 0.0]
                for k in range(len(color)):
                    xx, xy, yy = covariance[k].tolist()
                    xx, yy = xx + 0.3, yy + 0.3
                    dx, dy = j + 0.5 - means[b, k, 0].item(), i + 0.5 - means[b, k, 1].item()
                    square = (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy)
                    alpha = min(0.999, opacity[b, k].item() * math.exp(-square / 2))
                    if alpha < 1 / 255:
                        continue
                    if transmittance * (1 - alpha) <= 1e-4:
                        break
                    light = [
                        c + transmittance * alpha * own
                        for c, own in zip(light, color[k].tolist(), strict=True)
                    ]
                    transmittance *= 1 - alpha
                for c in range(3):
                    images[b, c, i, j] = light[c] + transmittance * background[c].item()
    return images


@pytest.mark.parametrize("opacity", [(0.0, 0.5), (0.8, 1.0)], ids=["translucent", "opaque"])
def test_the_specification_agrees_with_a_naive_loop(opacity):
    scene = [tensor.double() for tensor in random_scene(2, 25, 6, 9, sigma=3.0, opacity=opacity)]
    torch.testing.assert_close(
        rasterize(*scene, height=6, width=9),
        naive(*scene, height=6, width=9),
        atol=1e-12,
        rtol=0,
    )


def test_the_gradient_of_the_specification_agrees_with_differences():
    scene = [tensor.double().requires_grad_() for tensor in random_scene(1, 4, 4, 5, margin=0.0, seed=3)]
    assert torch.autograd.gradcheck(
        lambda *inputs: rasterize(*inputs, height=4, width=5), scene, eps=1e-7, atol=1e-5
    )


@pytest.mark.parametrize("backend", ["torch", "numba"])
def test_the_clamp_passes_no_gradient_on(backend):
    means = torch.tensor([[[0.5, 0.5]]], requires_grad=True)
    opacity = torch.tensor([[1.0]], requires_grad=True)
    covariance, color = torch.tensor([[4.0, 0.0, 4.0]]), torch.ones(1, 3)
    images = rasterize(means, covariance, opacity, color, torch.zeros(3), height=1, width=1, backend=backend)
    torch.testing.assert_close(images, torch.full((1, 3, 1, 1), 0.999))
    for gradient in torch.autograd.grad(images.sum(), (means, opacity)):
        assert (gradient == 0).all()


def test_gsplat_finds_every_pair_in_index_order():
    """gsplat's own tile lists, from its CPU twin: all pairs with alpha >= 1/255 are there, front to back."""
    reference = pytest.importorskip("gsplat.cuda._torch_impl", reason="gsplat is not installed")
    height, width, tile = 40, 50, TILE_PX
    planar = GaussianSlice(*random_scene(2, 60, height, width, opacity=(0.0, 1.0)))
    means, covariance, opacity, _, _ = planar
    scene = embed_in_space(planar)
    across, down = -(-width // tile), -(-height // tile)
    _, keys, order = reference._isect_tiles(scene.means, scene.radii, scene.depths, tile, across, down)
    offsets = reference._isect_offset_encode(keys, 2, across, down).flatten().tolist()
    listed = [order[a:b].tolist() for a, b in pairwise([*offsets, len(order)])]
    for image in range(2):
        alpha = evaluate_alphas(means[image], covariance, opacity[image], height, width)
        for part in range(across * down):
            y, x = part // across * tile, part % across * tile
            covered = (alpha[:, y : y + tile, x : x + tile] > 0).flatten(1).any(1).nonzero()[
                :, 0
            ] + 60 * image
            here = listed[image * across * down + part]
            assert here == sorted(here)
            assert set(covered.tolist()) <= set(here)


def test_gsplat_embedding_keeps_the_conics():
    scene = GaussianSlice(*random_scene(2, 10, 8, 8))
    covariance, conics = scene.covariance, embed_in_space(scene).conics[0]
    blurred = torch.stack([covariance[:, [0, 1]], covariance[:, [1, 2]]], 1) + 0.3 * torch.eye(2)
    inverse = torch.stack([conics[:, [0, 1]], conics[:, [1, 2]]], 1)
    torch.testing.assert_close(blurred @ inverse, torch.eye(2).expand(10, 2, 2), atol=1e-5, rtol=0)


@pytest.mark.gpu
@pytest.mark.parametrize("name", SCENES)
def test_gsplat_agrees_with_the_specification(name):
    pytest.importorskip("gsplat", reason="gsplat is not installed")
    scene, height, width = SCENES[name]
    images, gradients = images_and_gradients("gsplat", scene, height, width, torch.float32, "cuda")
    reference, expected = images_and_gradients("torch", scene, height, width, torch.float64)
    torch.testing.assert_close(images.double(), reference, atol=1e-4, rtol=0)
    assert_gradients_agree(gradients, expected)
