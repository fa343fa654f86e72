"""The choice of a rasteriser, and what the workflow knows of it."""

import pytest
import torch

from lagsplat import provenance
from lagsplat.splat import rasterize_torch as raster_torch
from lagsplat.splat.cpu import rasterize as raster_numba
from lagsplat.splat.image_model import choose_device, choose_rasterizer


def test_training_goes_where_the_rasteriser_draws():
    assert [choose_device(name) for name in ("numba", "torch", "gsplat")] == ["cpu", "cpu", "cuda"]
    assert choose_device("auto") in ("cpu", "cuda")


def test_the_device_decides_what_auto_means():
    assert choose_rasterizer("auto", "cpu") is raster_numba.rasterize
    assert choose_rasterizer("torch", torch.device("cpu")) is raster_torch.rasterize


@pytest.mark.parametrize(
    ("name", "device", "message"),
    [
        ("numpy", "cpu", "choose one of auto"),
        ("gsplat", "cpu", "draws on cuda"),
        ("numba", "cuda", "draws on cpu"),
    ],
)
def test_an_impossible_choice_is_refused(name, device, message):
    with pytest.raises(ValueError, match=message):
        choose_rasterizer(name, device)


def test_a_result_depends_on_every_rasteriser():
    pending, seen = ["lagsplat.splat.image_model"], set()
    while pending:
        module = pending.pop()
        if module not in seen:
            seen.add(module)
            pending += provenance._digest_and_imports(module)[1]
    assert {
        "lagsplat.splat.rasterize_gsplat",
        "lagsplat.splat.cpu.forward",
        "lagsplat.splat.cpu.simd",
    } <= seen
