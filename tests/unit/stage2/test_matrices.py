import pytest
import torch

from lagsplat.stage2.networks import ConstantMatrix, MatrixField, factor_positive


def spd(d: int) -> torch.Tensor:
    square = torch.randn(d, d, dtype=torch.float64)
    return square @ square.T + torch.eye(d, dtype=torch.float64)


def test_factor_reproduces_a_matrix_above_the_floor_and_lifts_one_below() -> None:
    matrix = spd(3)
    lower = factor_positive(matrix, 0.1)
    torch.testing.assert_close(lower @ lower.T + 0.1 * torch.eye(3, dtype=torch.float64), matrix)
    lifted = factor_positive(torch.diag(torch.tensor([1.0, 0.05], dtype=torch.float64)), 0.1)
    assert bool(torch.isfinite(lifted).all())


@pytest.mark.parametrize("kind", ["constant", "field"])
def test_product_and_accelerate_agree_with_the_matrix(kind: str) -> None:
    start = spd(3)
    term = (
        ConstantMatrix(start, floor=0.1)
        if kind == "constant"
        else MatrixField(start, floor=0.1, width=6, generator=torch.Generator().manual_seed(0))
    )
    q, v, f = torch.randn(3, 4, 3, dtype=torch.float64)
    torch.testing.assert_close(term.matrix(q), start.expand(4, 3, 3))
    if isinstance(term, MatrixField):
        with torch.no_grad():
            term.third.normal_(0.0, 0.3)
    torch.testing.assert_close(term.product(q, v), torch.einsum("bij,bj->bi", term.matrix(q), v))
    still = term.accelerate(q, 0.0 * v, f)
    torch.testing.assert_close(torch.einsum("bij,bj->bi", term.matrix(q), still), f)
