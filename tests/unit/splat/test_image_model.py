"""The image model in numbers that can be worked out by hand: profile, limits, and the end of a pixel."""

import inspect
import math

import pytest
import torch

from lagsplat.splat import image_model
from lagsplat.splat.image_model import blur, choose_backend, choose_device, rasterize

BOTH = pytest.mark.parametrize("backend", ["torch", "numba"])


def draw(opacity, *, covariance=(0.7, 0.0, 1.7), at=(2.5, 2.5), size=5, background=0.0, backend="torch"):
    """White Gaussians on a grey background at one place, front to back, in float32: one channel."""
    opacity, count = torch.as_tensor(opacity), len(opacity)
    return rasterize(
        torch.tensor(at).expand(1, count, 2),
        torch.tensor(covariance).expand(count, 3),
        opacity[None],
        torch.ones(count, 3),
        torch.full((3,), background),
        height=size,
        width=size,
        backend=backend,
    )[0, 1]


@BOTH
@pytest.mark.parametrize(
    ("covariance", "right", "down", "sigma"),
    [
        ((0.7, 0.0, 1.7), 1, 0, 1 / 2),  # blurred by 0.3 px^2 it is diag(1, 2)
        ((0.7, 0.0, 1.7), 0, 1, 1 / 4),
        ((0.7, 0.0, 1.7), 2, 1, 9 / 4),
        ((1.7, 1.0, 0.7), 1, 1, 1 / 2),  # [[2, 1], [1, 1]], whose inverse is [[1, -1], [-1, 2]]
        ((1.7, 1.0, 0.7), 1, -1, 5 / 2),
        ((1.7, -1.0, 0.7), -1, 1, 1 / 2),
        ((0.2, 0.4, 0.2), 1, 1, 10 / 9),  # determinant 0.09
    ],
)
def test_alpha_falls_by_the_blurred_covariance(backend, covariance, right, down, sigma):
    image = draw([0.8], covariance=covariance, backend=backend)
    assert float(image[2 + down, 2 + right]) == pytest.approx(0.8 * math.exp(-sigma), rel=1e-4)


@BOTH
def test_no_gaussian_hides_all_behind_it(backend):
    opacity = torch.tensor([1.0, 0.5], requires_grad=True)
    pixel = draw(opacity, background=0.5, backend=backend)[2, 2]
    assert pixel.item() == pytest.approx(0.999 + 0.001 * 0.75, abs=1e-6)
    pixel.backward()
    assert opacity.grad[0] == 0.0  # the limit passes no gradient
    assert float(opacity.grad[1]) == pytest.approx(0.001 * 0.5, abs=1e-6)


@BOTH
@pytest.mark.parametrize(("share", "drawn"), [(1.001, True), (0.999, False)])
def test_what_covers_less_than_a_255th_is_skipped(backend, share, drawn):
    opacity = torch.tensor([share / 255], requires_grad=True)
    pixel = draw(opacity, backend=backend)[2, 2]
    assert pixel.item() == pytest.approx(share / 255 if drawn else 0.0, rel=1e-4)
    pixel.backward()
    assert opacity.grad.item() == pytest.approx(1.0 if drawn else 0.0)


def test_exactly_a_255th_is_drawn():
    opacity = torch.full((1,), 1 / 255, dtype=torch.float32)
    assert float(draw(opacity)[2, 2]) == pytest.approx(1 / 255)


@BOTH
def test_the_gaussian_that_would_darken_a_pixel_to_a_ten_thousandth_ends_it(backend):
    # 0.02 and 0.0004 are left behind the first two; the third would leave 0.000008, so it and the fourth,
    # which alone would leave 0.0002, are not composited
    pixel = draw([0.98, 0.98, 0.98, 0.5], background=0.5, backend=backend)[2, 2]
    assert pixel.item() == pytest.approx(0.9996 + 0.0004 * 0.5, abs=1e-6)


@BOTH
def test_a_pixel_goes_on_above_a_ten_thousandth(backend):
    pixel = draw([0.98, 0.98, 0.5], background=0.0, backend=backend)[2, 2]
    assert pixel.item() == pytest.approx(0.9998, abs=1e-6)


@BOTH
@pytest.mark.parametrize(
    "covariance",
    [
        (-0.8, 0.0, -0.8),  # blurred it is -1/2 of the identity
        (0.2, 0.6, 0.2),  # indefinite
        (-0.4, 0.0, 1.7),
    ],
)
def test_what_is_not_positive_definite_is_not_drawn(backend, covariance):
    assert torch.count_nonzero(draw([0.8], covariance=covariance, backend=backend)) == 0


def test_a_degenerate_covariance_is_replaced_before_it_divides():
    xx, xy, yy, proper = blur(torch.tensor([[[0.2, 0.5, 0.2], [0.7, 0.5, 1.7]]], dtype=torch.float64))
    assert proper.tolist() == [[False, True]]
    assert torch.stack([xx, xy, yy], -1).tolist() == [[[1.0, 0.0, 1.0], [1.0, 0.5, 2.0]]]


@BOTH
def test_a_single_pixel_is_an_image(backend):
    assert draw([0.8], at=(0.5, 0.5), size=1, backend=backend).tolist() == [[pytest.approx(0.8)]]


@BOTH
def test_each_image_may_have_its_own_covariances_and_colors(backend):
    means, opacity = torch.full((2, 1, 2), 2.5), torch.full((2, 1), 0.8)
    covariance = torch.tensor([[[0.7, 0.0, 1.7]], [[1.7, 0.0, 0.7]]])
    color = torch.tensor([[[1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]]])
    size = {"height": 5, "width": 5, "backend": backend}
    first, second = rasterize(means, covariance, opacity, color, torch.zeros(3), **size)
    assert torch.allclose(first[0], second[2].T)
    assert torch.count_nonzero(first[1:]) == torch.count_nonzero(second[:2]) == 0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"width": 0}, "an image of 5 x 0 pixels: both must be at least 1"),
        ({"color": torch.ones(2, 1, 4)}, r"color has shape \(2, 1, 4\), expected \(1, 3\), or one for each"),
        ({"covariance": torch.ones(2, 1, 3)}, r"color has shape \(1, 3\), expected \(2, 1, 3\)$"),
        ({"background": torch.ones(4)}, r"background has shape \(4,\), expected \(3\)$"),
        ({"color": torch.ones(1, 3, dtype=torch.int64)}, "color is torch.int64, means torch.float32: use"),
        ({"color": torch.ones(1, 3, device="meta")}, "color is on meta, means on cpu: use one device"),
    ],
)
def test_what_does_not_match_is_named(change, message):
    scene = {
        "means": torch.ones(2, 1, 2),
        "covariance": torch.ones(1, 3),
        "opacity": torch.ones(2, 1),
        "color": torch.ones(1, 3),
        "background": torch.ones(3),
    }
    with pytest.raises(ValueError, match=message):
        inspect.unwrap(rasterize)(**{**scene, "height": 5, "width": 5, **change})


def test_only_covariance_and_color_may_be_given_for_each_image():
    scene = [torch.ones(shape) for shape in ((3, 3, 2), (3, 3), (3, 4), (3, 3), (3,))]
    with pytest.raises(ValueError, match=r"opacity has shape \(3, 4\), expected \(3, 3\)$"):
        inspect.unwrap(rasterize)(*scene, height=4, width=5)


def test_whole_numbers_are_no_scene():
    scene = [torch.ones(shape, dtype=torch.int64) for shape in ((1, 2, 2), (2, 3), (1, 2), (2, 3), (3,))]
    with pytest.raises(ValueError, match=r"means is torch.int64, means torch.int64: use one floating type"):
        inspect.unwrap(rasterize)(*scene, height=4, width=5)


@pytest.mark.parametrize("cuda", [False, True])
@pytest.mark.parametrize("gsplat", [None, object()])
def test_training_takes_cuda_where_cuda_and_its_rasteriser_are_there(monkeypatch, cuda, gsplat):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: cuda)
    monkeypatch.setattr(image_model, "find_spec", lambda name: gsplat)
    assert choose_device("auto") == ("cuda" if cuda and gsplat else "cpu")
    assert choose_backend("cuda") == ("gsplat" if gsplat else "torch")
