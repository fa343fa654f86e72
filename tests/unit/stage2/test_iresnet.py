import torch
from torch.autograd.functional import jacobian

from lagsplat.stage2.networks import Diffeomorphism, contract_spectral_norm, pull_back, push_forward


def test_contract_caps_the_largest_singular_value_and_leaves_small_matrices() -> None:
    wide = torch.stack([5.0 * torch.randn(3, 9), 0.01 * torch.randn(3, 9)]).double()
    got = contract_spectral_norm(wide)
    assert float(torch.linalg.matrix_norm(got[0], 2)) <= 1.0 + 1e-12
    torch.testing.assert_close(got[1], wide[1])
    torch.testing.assert_close(contract_spectral_norm(wide.mT.contiguous()), got.mT)


def test_pull_is_the_transpose_of_the_jacobian_and_the_map_never_folds() -> None:
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
