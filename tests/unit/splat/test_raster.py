"""Promises of the rasterisers at the edges: bad arguments, empty scenes, what is not finite."""

import inspect

import pytest
import torch

from lagsplat.splat import rasterize_gsplat
from lagsplat.splat.image_model import choose_backend, rasterize

BOTH = pytest.mark.parametrize("backend", ["torch", "numba"])


def scene(batch=2, count=6):
    generator = torch.Generator().manual_seed(0)
    return {
        "means": 10 * torch.rand(batch, count, 2, generator=generator),
        "covariance": torch.tensor([4.0, 1.0, 3.0]).repeat(count, 1),
        "opacity": 0.2 + 0.6 * torch.rand(batch, count, generator=generator),
        "color": torch.rand(count, 3, generator=generator),
        "background": torch.tensor([0.1, 0.2, 0.3]),
    }


@BOTH
def test_without_gaussians_there_is_background(backend):
    empty = scene(count=0)
    background = empty["background"].requires_grad_()
    images = rasterize(**empty, height=4, width=5, backend=backend)
    assert torch.equal(images, background[None, :, None, None].expand(2, 3, 4, 5))
    images.sum().backward()
    assert background.grad.tolist() == [40.0] * 3


@BOTH
def test_an_empty_batch_is_an_empty_batch(backend):
    assert rasterize(**scene(batch=0), height=4, width=5, backend=backend).shape == (0, 3, 4, 5)


@BOTH
@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
@pytest.mark.parametrize("name", ["means", "covariance", "opacity"])
def test_what_is_not_finite_is_not_drawn(backend, name, value):
    broken, without = scene(), scene()
    (broken[name][..., 2, :] if name != "opacity" else broken[name][:, 2]).fill_(value)
    without["opacity"][:, 2] = 0.0
    inputs = {key: tensor.requires_grad_() for key, tensor in broken.items()}
    size = {"height": 10, "width": 10, "backend": backend}
    images = rasterize(**inputs, **size)
    torch.testing.assert_close(images, rasterize(**without, **size))
    images.sum().backward()
    for key, tensor in inputs.items():
        assert tensor.grad.isfinite().all(), key
    assert (inputs["means"].grad[:, 2] == 0).all()
    assert (inputs["covariance"].grad[2] == 0).all()


@BOTH
@pytest.mark.parametrize(
    "covariance", [(-1.0, 0.0, 1.0), (1.0, 2.0, 1.0), (1e30, 0.0, 1e30), (1e38, 1e38, 1e38)]
)
@pytest.mark.parametrize("mean", [0.0, -1e30, 3e38])
def test_extreme_gaussians_harm_nothing(backend, covariance, mean):
    extreme = scene()
    extreme["covariance"][3] = torch.tensor(covariance)
    extreme["means"][0, 3] = mean
    images = rasterize(**extreme, height=33, width=34, backend=backend)
    assert images.isfinite().all()
    assert (images >= 0).all()
    assert (images <= 1.0001).all()


@BOTH
def test_one_gaussian_shows_its_peak(backend):
    peak = rasterize(
        torch.tensor([[[2.5, 1.5]]]),
        torch.tensor([[2.0, 0.5, 1.0]]),
        torch.tensor([[0.6]]),
        torch.tensor([[1.0, 0.5, 0.0]]),
        torch.tensor([0.0, 0.0, 1.0]),
        height=4,
        width=6,
        backend=backend,
    )[0, :, 1, 2]
    torch.testing.assert_close(peak, torch.tensor([0.6, 0.3, 0.4]), atol=1e-5, rtol=0)


@BOTH
@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"means": torch.zeros(6, 2)}, r"means has shape \(6, 2\), expected \(B, K, 2\)"),
        ({"covariance": torch.zeros(6, 2, 2)}, r"covariance has shape \(6, 2, 2\), expected \(6, 3\)"),
        ({"opacity": torch.zeros(2, 5)}, r"opacity has shape \(2, 5\), expected \(2, 6\)"),
        ({"color": torch.zeros(6, 4)}, r"color has shape \(6, 4\), expected \(6, 3\)"),
        ({"background": torch.zeros(1, 3)}, r"background has shape \(1, 3\), expected \(3\)"),
        (
            {"opacity": torch.zeros(2, 6, dtype=torch.float64)},
            "opacity is torch.float64, means torch.float32",
        ),
        ({"height": 0}, "cannot draw an image of 0 x 10 pixels"),
    ],
)
def test_bad_arguments_are_named(backend, change, message):
    with pytest.raises(ValueError, match=message):
        inspect.unwrap(rasterize)(**{**scene(), "height": 10, "width": 10, **change}, backend=backend)


def test_numba_wants_float32():
    double = {name: tensor.double() for name, tensor in scene().items()}
    with pytest.raises(ValueError, match="draws float32 tensors on cpu, got"):
        rasterize(**double, height=10, width=10, backend="numba")


def test_numba_reads_any_memory_layout():
    plain = scene()
    strided = {name: tensor.repeat_interleave(2, -1)[..., ::2] for name, tensor in plain.items()}
    assert not strided["means"].is_contiguous()
    size = {"height": 10, "width": 11, "backend": "numba"}
    assert torch.equal(rasterize(**strided, **size), rasterize(**plain, **size))


@pytest.mark.parametrize("wanted", ["means", "covariance", "opacity", "color", "background"])
def test_numba_gives_single_gradients(wanted):
    all_inputs = {name: tensor.requires_grad_() for name, tensor in scene().items()}
    one_input = scene()
    one_input[wanted].requires_grad_()
    for inputs in (all_inputs, one_input):
        rasterize(**inputs, height=10, width=10, backend="numba").square().sum().backward()
    assert torch.equal(one_input[wanted].grad, all_inputs[wanted].grad)


def test_gsplat_refuses_the_cpu_and_names_the_way_out():
    with pytest.raises(
        ValueError, match=r"'gsplat' draws .* on cuda, got torch.float32 on cpu: .* choose 'torch'"
    ):
        rasterize(**scene(), height=10, width=10, backend="gsplat")


def test_gsplat_without_kernels_says_what_to_install(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "gsplat", None)
    with pytest.raises(ImportError, match=r"pip install 'lagsplat\[cuda\]'"):
        rasterize_gsplat._require_gsplat()


def test_auto_draws_on_the_cpu_with_numba():
    assert choose_backend("cpu") == "numba"
    size = {"height": 10, "width": 11}
    assert torch.equal(
        rasterize(**scene(), **size, backend="auto"), rasterize(**scene(), **size, backend="numba")
    )


@pytest.mark.parametrize("backend", ["opengl", ""])
def test_an_unknown_rasteriser_lists_the_choices(backend):
    with pytest.raises(ValueError, match=f"'{backend}': choose one of auto, torch, numba, gsplat"):
        rasterize(**scene(), height=10, width=10, backend=backend)
