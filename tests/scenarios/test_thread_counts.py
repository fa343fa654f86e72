"""Results do not depend on the number of threads. These tests run in one process, which has all cores."""

import numba
import pytest
import torch

from lagsplat.splat.image_model import rasterize
from tests.unit.splat.test_raster import scene


@pytest.mark.parametrize("batch", [1, 2, 3])
def test_gradients_of_an_image_change_by_no_more_than_rounding(batch: int) -> None:
    def gradients(threads: int) -> list[torch.Tensor | None]:
        before = numba.get_num_threads()
        numba.set_num_threads(threads)
        try:
            inputs = {name: tensor.requires_grad_() for name, tensor in scene(batch).items()}
            rasterize(**inputs, height=40, width=70, backend="numba").square().sum().backward()
            return [tensor.grad for tensor in inputs.values()]
        finally:
            numba.set_num_threads(before)

    for one, many in zip(gradients(1), gradients(numba.config.NUMBA_NUM_THREADS), strict=True):
        torch.testing.assert_close(one, many, rtol=1e-4, atol=1e-4)
