"""Results do not depend on the number of threads. These tests run in one process, which has all cores."""

from collections.abc import Callable
from typing import TypeVar

import numba
import numpy as np
import pytest
import torch

from lagsplat.diagnose.estimation.dataset import WindowSet
from lagsplat.splat.image_model import rasterize
from tests.oracle.test_runge_kutta import rolled, uneven, wild
from tests.unit.splat.test_raster import scene

T = TypeVar("T")


def with_threads(threads: int, compute: Callable[[], T]) -> T:
    before = numba.get_num_threads()
    numba.set_num_threads(threads)
    try:
        return compute()
    finally:
        numba.set_num_threads(before)


@pytest.mark.parametrize("own", [False, True], ids=["shared", "own"])
@pytest.mark.parametrize("batch", [1, 3, 32])
def test_gradients_of_an_image_are_the_same(batch: int, own: bool) -> None:
    inputs = scene(batch, count=60)
    inputs["means"] *= torch.tensor([7.0, 4.0])  # all over the tiles
    for name in ("covariance", "color"):
        inputs[name] = inputs[name].expand(batch, -1, -1).clone() if own else inputs[name]

    def gradients() -> list[torch.Tensor | None]:
        leaves = {name: tensor.clone().requires_grad_() for name, tensor in inputs.items()}
        rasterize(**leaves, height=40, width=70, backend="numba").square().sum().backward()
        return [tensor.grad for tensor in leaves.values()]

    expected = with_threads(1, gradients)
    for threads in range(2, min(3, numba.config.NUMBA_NUM_THREADS) + 1):
        for one, other in zip(expected, with_threads(threads, gradients), strict=True):
            torch.testing.assert_close(one, other, rtol=0, atol=0)


def test_rollouts_are_the_same() -> None:
    model, (time, u) = wild(2, 1), uneven(240, 1)
    first = np.arange(230)
    windows = WindowSet(first, np.full(len(first), 10))
    states = np.random.default_rng(2).normal(0.0, 0.5, (len(time), 4))

    def roll_out() -> tuple[np.ndarray, np.ndarray]:
        return rolled(model, time, u, states, windows, [], [], held=False, steps=2)

    many = with_threads(numba.config.NUMBA_NUM_THREADS, roll_out)
    for one, other in zip(with_threads(1, roll_out), many, strict=True):
        np.testing.assert_array_equal(one, other)
