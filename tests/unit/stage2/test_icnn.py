import torch

from lagsplat.stage2.networks import Icnn


def net(heads: int = 1) -> Icnn:
    made = Icnn(3, width=7, heads=heads, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        made.head.uniform_(0.0, 1.0)
        made.between.normal_(-2.0)
    return made


def test_written_gradient_is_that_of_the_value() -> None:
    icnn = net(2)
    u = torch.randn(5, 3, dtype=torch.float64, requires_grad=True)
    load = torch.rand(5, 2, dtype=torch.float64)
    (want,) = torch.autograd.grad((icnn.value(u) * load).sum(), u)
    got = icnn.gradient(u, load @ icnn.head, icnn.between_weight())
    torch.testing.assert_close(got, want)


def test_convex_along_lines_and_silent_at_the_start() -> None:
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
