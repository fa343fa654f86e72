"""Networks of the law: convex network, diffeomorphism and matrix fields."""

import pytest
import torch
from torch.autograd.functional import jacobian

from lagsplat.stage2.networks import (
    ConstantMatrix,
    Diffeomorphism,
    Icnn,
    MatrixField,
    contract_spectral_norm,
    factor_positive,
    pull_back,
    push_forward,
)


def net(heads: int = 1) -> Icnn:
    made = Icnn(3, width=7, heads=heads, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        made.head.uniform_(0.0, 1.0)
        made.between.normal_(-2.0)
    return made


def test_the_explicit_gradient_is_that_of_the_value() -> None:
    icnn = net(2)
    u = torch.randn(5, 3, dtype=torch.float64, requires_grad=True)
    load = torch.rand(5, 2, dtype=torch.float64)
    (want,) = torch.autograd.grad((icnn.value(u) * load).sum(), u)
    got = icnn.gradient(u, load @ icnn.head, icnn.between_weight())
    torch.testing.assert_close(got, want)


def test_the_network_is_convex_along_lines_and_zero_at_the_start() -> None:
    icnn = net()
    a, b = torch.randn(2, 50, 3, dtype=torch.float64)
    assert bool((icnn.value(0.5 * (a + b)) <= 0.5 * (icnn.value(a) + icnn.value(b)) + 1e-12).all())
    fresh = Icnn(3, width=7, heads=1, generator=torch.Generator().manual_seed(0))
    assert float(fresh.value(a).abs().max().detach()) == 0.0


def test_project_restores_the_sign() -> None:
    icnn = net()
    with torch.no_grad():
        icnn.head.sub_(0.5)
    icnn.project()
    assert float(icnn.head.detach().min()) == 0.0


def test_contract_caps_the_largest_singular_value_and_leaves_small_matrices() -> None:
    wide = torch.stack([5.0 * torch.randn(3, 9), 0.01 * torch.randn(3, 9)]).double()
    got = contract_spectral_norm(wide)
    assert float(torch.linalg.matrix_norm(got[0], 2)) <= 1.0 + 1e-12
    torch.testing.assert_close(got[1], wide[1])
    torch.testing.assert_close(contract_spectral_norm(wide.mT.contiguous()), got.mT)


def test_pull_back_is_the_transposed_jacobian_and_the_map_never_folds() -> None:
    diffeo = Diffeomorphism(3, blocks=2, width=8, lipschitz=0.9, generator=torch.Generator().manual_seed(1))
    q = torch.randn(1, 3, dtype=torch.float64)
    torch.testing.assert_close(push_forward(q, diffeo.blocks())[0], q)
    with torch.no_grad():
        diffeo.outer.normal_(0.0, 3.0)
    blocks = diffeo.blocks()
    slope = jacobian(lambda x: push_forward(x[None], blocks)[0][0], q[0])
    covector = torch.randn(1, 3, dtype=torch.float64)
    got = pull_back(covector, blocks, push_forward(q, blocks)[1])
    torch.testing.assert_close(got[0], covector[0] @ slope)
    # each block keeps at least a tenth of every length
    assert float(torch.linalg.svdvals(slope).min()) >= 0.01


def test_no_block_is_the_identity() -> None:
    q = torch.randn(2, 3, dtype=torch.float64)
    image, hidden = push_forward(q, [])
    torch.testing.assert_close(image, q)
    torch.testing.assert_close(pull_back(q, [], hidden), q)


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
