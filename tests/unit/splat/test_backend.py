"""The choice of a rasteriser, and what the workflow knows of it."""

import pytest
import torch

from lagsplat import provenance
from lagsplat.splat.image_model import choose_backend, choose_device, rasterize


def test_training_goes_where_the_rasteriser_draws():
    assert [choose_device(name) for name in ("numba", "torch", "gsplat")] == ["cpu", "cpu", "cuda"]
    assert choose_device("auto") in ("cpu", "cuda")


def test_the_device_decides_what_auto_means():
    assert choose_backend("cpu") == "numba"
    assert choose_backend("cuda") in ("gsplat", "torch")
    assert choose_backend("mps") == "torch"


@pytest.mark.parametrize(
    ("name", "device", "message"),
    [
        ("numpy", "cpu", "choose one of auto"),
        ("gsplat", "cpu", "draws float32 tensors on cuda, got torch.float32 on cpu"),
        ("numba", "meta", "draws float32 tensors on cpu, got torch.float32 on meta"),
    ],
)
def test_an_impossible_choice_is_refused(name, device, message):
    scene = [torch.zeros(shape, device=device) for shape in ((1, 2, 2), (2, 3), (1, 2), (2, 3), (3,))]
    with pytest.raises(ValueError, match=message):
        rasterize(*scene, height=4, width=5, backend=name)


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
