"""Laws every rasteriser obeys, whatever the scene."""

from functools import partial

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from lagsplat.splat.image_model import rasterize

BOTH = pytest.mark.parametrize(
    "rasterize",
    [partial(rasterize, backend="torch"), partial(rasterize, backend="numba")],
    ids=["torch", "numba"],
)
# The first call may compile the kernels, so no single example has a deadline.
FEW = settings(max_examples=15, deadline=None)
SEEDS = st.integers(0, 2**31)


def scene(seed, count, height, width, *, inside=0.0):
    generator = torch.Generator().manual_seed(seed)
    size = torch.tensor([width, height]) - 2 * inside
    scale = 0.3 + 2.0 * torch.rand(count, 2, generator=generator)
    correlation = 1.8 * torch.rand(count, generator=generator) - 0.9
    return {
        "means": inside + size * torch.rand(1, count, 2, generator=generator),
        "covariance": torch.stack([scale[:, 0] ** 2, correlation * scale.prod(1), scale[:, 1] ** 2], 1),
        "opacity": torch.rand(1, count, generator=generator),
        "color": torch.rand(count, 3, generator=generator),
        "background": torch.rand(3, generator=generator),
    }


@BOTH
@FEW
@given(seed=SEEDS, count=st.integers(1, 60), height=st.integers(1, 40), width=st.integers(1, 40))
def test_colors_in_the_unit_interval_stay_there(rasterize, seed, count, height, width):
    images = rasterize(**scene(seed, count, height, width), height=height, width=width)
    assert images.min() >= -1e-5
    assert images.max() <= 1 + 1e-5


@BOTH
@FEW
@given(seed=SEEDS, color=st.floats(0, 1))
def test_a_scene_of_one_color_is_that_color(rasterize, seed, color):
    uniform = scene(seed, 30, 12, 34)
    uniform["color"].fill_(color)
    uniform["background"].fill_(color)
    images = rasterize(**uniform, height=12, width=34)
    torch.testing.assert_close(images, torch.full_like(images, color), atol=1e-5, rtol=0)


@BOTH
@FEW
@given(seed=SEEDS, right=st.integers(0, 30), down=st.integers(0, 30))
def test_a_shift_by_whole_pixels_shifts_the_image(rasterize, seed, right, down):
    plain = scene(seed, 20, 24, 24)
    # Powers of two apart, so that the shifted centres are exact in float32.
    plain["means"] = (plain["means"] * 256).round() / 256
    moved = {**plain, "means": plain["means"] + torch.tensor([right, down])}
    image = rasterize(**plain, height=24, width=24)
    larger = rasterize(**moved, height=24 + down, width=24 + right)
    torch.testing.assert_close(larger[..., down:, right:], image, atol=1e-4, rtol=0)


@BOTH
@FEW
@given(seed=SEEDS, opacity=st.floats(0.01, 0.99), row=st.integers(0, 8), column=st.integers(0, 11))
def test_a_gaussian_on_a_pixel_centre_shows_its_opacity(rasterize, seed, opacity, row, column):
    one = scene(seed, 1, 9, 12)
    one["means"] = torch.tensor([[[column + 0.5, row + 0.5]]])
    one["opacity"].fill_(opacity)
    pixel = rasterize(**one, height=9, width=12)[0, :, row, column]
    expected = opacity * one["color"][0] + (1 - opacity) * one["background"]
    torch.testing.assert_close(pixel, expected, atol=1e-5, rtol=0)


@BOTH
@FEW
@given(seed=SEEDS, order=st.permutations(range(6)))
def test_the_order_of_gaussians_apart_does_not_matter(rasterize, seed, order):
    apart = scene(seed, 6, 14, 84)
    apart["means"] = torch.stack([7.0 + 14.0 * torch.arange(6), torch.full((6,), 7.0)], 1)[None]
    apart["covariance"].clamp_(-0.1, 1.0)
    shuffled = {
        "means": apart["means"][:, order],
        "covariance": apart["covariance"][order],
        "opacity": apart["opacity"][:, order],
        "color": apart["color"][order],
        "background": apart["background"],
    }
    size = {"height": 14, "width": 84}
    torch.testing.assert_close(rasterize(**shuffled, **size), rasterize(**apart, **size), atol=1e-6, rtol=0)


@BOTH
@FEW
@given(seed=SEEDS)
def test_images_of_a_batch_are_those_of_its_parts(rasterize, seed):
    first, second = scene(seed, 25, 35, 10), scene(seed + 1, 25, 35, 10)
    both = {**first, **{name: torch.cat([first[name], second[name]]) for name in ("means", "opacity")}}
    alone = {**first, "means": second["means"], "opacity": second["opacity"]}
    images = rasterize(**both, height=35, width=10)
    assert torch.equal(images[:1], rasterize(**first, height=35, width=10))
    assert torch.equal(images[1:], rasterize(**alone, height=35, width=10))
