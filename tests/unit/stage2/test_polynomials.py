"""Polynomial terms: their monomials, what they start as, and what they do far away."""

import numpy as np
import pytest
import torch
from torch.autograd.functional import jacobian

from lagsplat.stage2.polynomials import (
    PolynomialEnergy,
    PolynomialField,
    PolynomialFrame,
    differentiate_monomials,
    evaluate_monomials,
    list_exponents,
)


def box(d: int, half: float) -> torch.Tensor:
    return half * torch.tensor([[-1.0], [1.0]], dtype=torch.float64).expand(2, d)


def test_monomials_are_counted_once_and_by_degree() -> None:
    exponents = list_exponents(3, lowest=1, highest=3)
    degrees = exponents.sum(1).tolist()
    assert degrees == sorted(degrees)
    assert len(exponents) == len({tuple(row) for row in exponents.tolist()}) == 3 + 6 + 10
    assert list_exponents(2, lowest=2, highest=1).shape == (0, 2)


def test_slopes_are_those_of_the_values() -> None:
    exponents = list_exponents(3, lowest=1, highest=4)
    q = torch.randn(3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    wanted = jacobian(lambda x: evaluate_monomials(x[None], exponents, box=box(3, 2.0))[0][0], q)
    value, slope, bend = differentiate_monomials(q[None], exponents, box=box(3, 2.0))
    torch.testing.assert_close(slope[0], wanted)
    for one, other in zip(
        (value, slope), evaluate_monomials(q[None], exponents, box=box(3, 2.0)), strict=True
    ):
        torch.testing.assert_close(one, other)
    wanted = jacobian(lambda x: evaluate_monomials(x[None], exponents, box=box(3, 2.0))[1][0], q)
    torch.testing.assert_close(bend[0], wanted)


def test_an_energy_set_to_a_quadratic_is_one_near_the_data() -> None:
    generator = torch.Generator().manual_seed(0)
    factor = torch.randn(2, 2, dtype=torch.float64, generator=generator)
    stiffness = factor @ factor.T + torch.eye(2, dtype=torch.float64)
    rest, pressure_map = torch.randn(2, 2, dtype=torch.float64, generator=generator), torch.eye(2).double()
    energy = PolynomialEnergy(2, 2, potential_degree=4, input_degree=3, box=box(2, 1e4), far_stiffness=0.1)
    energy.set_quadratic(stiffness, rest[0], pressure_map)
    q, u = torch.randn(2, 5, 2, dtype=torch.float64, generator=generator)
    wanted = (q - rest[0]) @ stiffness - u @ pressure_map
    torch.testing.assert_close(energy.slope(q, u), wanted, rtol=1e-5, atol=1e-5)


def test_far_away_only_a_spring_is_left() -> None:
    energy = PolynomialEnergy(2, 1, potential_degree=4, input_degree=3, box=box(2, 3.0), far_stiffness=0.1)
    with torch.no_grad():
        energy.coefficients.fill_(-5.0)
        energy.input_coefficients.fill_(7.0)
    q = torch.tensor([[60.0, -60.0]], dtype=torch.float64)
    torch.testing.assert_close(
        energy.slope(q, torch.ones(1, 1).double()), 0.1 * (q - 4.5 * q.sign()), rtol=0, atol=1e-9
    )


@pytest.mark.parametrize("d", [1, 3])
def test_a_field_starts_as_its_matrix_and_stays_positive(d: int) -> None:
    start = torch.eye(d, dtype=torch.float64) + 0.3
    field = PolynomialField(start, floor=0.05, frame=PolynomialFrame(d, degree=2, box=box(d, 4.0)))
    q = 3.0 * torch.randn(40, d, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(field.matrix(q), start.expand(40, d, d))
    with torch.no_grad():
        field.frame.coefficients.normal_(generator=torch.Generator().manual_seed(1))
    values = np.linalg.eigvalsh(field.matrix(q).detach().numpy())
    assert values.min() >= 0.05 * (1 - 1e-9)


def test_a_field_of_degree_zero_is_its_matrix_everywhere() -> None:
    start = torch.eye(2, dtype=torch.float64) + 0.3
    field = PolynomialField(start, floor=0.05, frame=PolynomialFrame(2, degree=0, box=box(2, 4.0)))
    q, v, force = torch.randn(3, 5, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(field.product(q, v), v @ start)
    torch.testing.assert_close(field.accelerate(q, v, force), torch.linalg.solve(start, force.T).T)
