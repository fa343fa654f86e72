"""Polynomial terms: their monomials, what they start as, and what they do far away."""

import numpy as np
import pytest
import torch
from torch.autograd.functional import jacobian

from lagsplat.monomials import differentiate_monomials, evaluate_monomials, list_exponents, make_wide_ball
from lagsplat.stage2.equilibrium import linearize_modes
from lagsplat.stage2.polynomials import PolynomialEnergy, PolynomialField, PolynomialFrame, PolynomialMap
from lagsplat.stage2.rollout import rollout
from tests.stage2_problems import random_lagrangian


def test_monomials_are_counted_once_and_by_degree() -> None:
    exponents = list_exponents(3, lowest=1, highest=3)
    degrees = exponents.sum(1).tolist()
    assert degrees == sorted(degrees)
    assert len(exponents) == len({tuple(row) for row in exponents.tolist()}) == 3 + 6 + 10
    assert list_exponents(2, lowest=2, highest=1).shape == (0, 2)


@pytest.mark.parametrize("radius", [0.5, 9.0])  # the state is outside and inside
@pytest.mark.parametrize("free_degree", [0, 2])
def test_slopes_are_those_of_the_values(radius: float, free_degree: int) -> None:
    exponents = list_exponents(3, lowest=1, highest=4)
    q = torch.randn(3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    ball = torch.tensor([0.1, 0.2, -0.3, radius], dtype=torch.float64)
    wanted = jacobian(
        lambda x: evaluate_monomials(x[None], exponents, ball=ball, free_degree=free_degree)[0][0], q
    )
    value, slope, bend = differentiate_monomials(q[None], exponents, ball=ball, free_degree=free_degree)
    torch.testing.assert_close(slope[0], wanted)
    for one, other in zip(
        (value, slope),
        evaluate_monomials(q[None], exponents, ball=ball, free_degree=free_degree),
        strict=True,
    ):
        torch.testing.assert_close(one, other)
    wanted = jacobian(
        lambda x: evaluate_monomials(x[None], exponents, ball=ball, free_degree=free_degree)[1][0], q
    )
    torch.testing.assert_close(bend[0], wanted)


@pytest.mark.parametrize("radius", [0.5, 9.0])
def test_an_energy_set_to_a_quadratic_is_one_everywhere(radius: float) -> None:
    generator = torch.Generator().manual_seed(0)
    factor = torch.randn(2, 2, dtype=torch.float64, generator=generator)
    stiffness = factor @ factor.T + torch.eye(2, dtype=torch.float64)
    rest, pressure_map = torch.randn(2, 2, dtype=torch.float64, generator=generator), torch.eye(2).double()
    energy = PolynomialEnergy(2, 2, potential_degree=4, input_degree=3, ball=make_wide_ball(2, radius))
    energy.set_quadratic(stiffness, rest[0], pressure_map)
    q, u = torch.randn(2, 5, 2, dtype=torch.float64, generator=generator)
    wanted = (q - rest[0]) @ stiffness - u @ pressure_map
    torch.testing.assert_close(energy.slope(q, u), wanted)
    torch.testing.assert_close(energy.differentiate(q, u)[1], stiffness.expand(5, 2, 2))


def test_far_away_only_a_spring_is_left() -> None:
    energy = PolynomialEnergy(2, 1, potential_degree=4, input_degree=3, ball=make_wide_ball(2, 3.0))
    with torch.no_grad():
        energy.coefficients.fill_(-5.0)
        energy.input_coefficients.fill_(7.0)
        energy.coefficients[2:5] = torch.tensor([0.2, 0.1, 0.3])
    q = torch.tensor([[6e9, -6e9]], dtype=torch.float64)
    stiffness = torch.tensor([[0.4, 0.1], [0.1, 0.6]], dtype=torch.float64)
    torch.testing.assert_close(energy.slope(q, torch.ones(1, 1).double()), q @ stiffness)
    values = energy.potential(q * torch.logspace(-9, 0, 50).double()[:, None])
    assert (values.diff()[5:] > 0.0).all()
    assert energy.measure_far_stiffness() == pytest.approx(0.5 - np.sqrt(0.02))
    with torch.no_grad():
        energy.coefficients[3] = 1.0
    assert energy.measure_far_stiffness() < 0.0


@pytest.mark.parametrize("d", [1, 3])
def test_a_field_starts_as_its_matrix_and_stays_positive(d: int) -> None:
    start = torch.eye(d, dtype=torch.float64) + 0.3
    field = PolynomialField(
        start, floor=0.05, frame=PolynomialFrame(d, degree=2, ball=make_wide_ball(d, 4.0))
    )
    q = 3.0 * torch.randn(40, d, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(field.matrix(q), start.expand(40, d, d))
    with torch.no_grad():
        field.frame.coefficients.normal_(generator=torch.Generator().manual_seed(1))
    values = np.linalg.eigvalsh(field.matrix(q).detach().numpy())
    assert values.min() >= 0.05 * (1 - 1e-9)


def test_a_field_of_degree_zero_is_its_matrix_everywhere() -> None:
    start = torch.eye(2, dtype=torch.float64) + 0.3
    field = PolynomialField(
        start, floor=0.05, frame=PolynomialFrame(2, degree=0, ball=make_wide_ball(2, 4.0))
    )
    q, v, force = torch.randn(3, 5, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(field.product(q, v), v @ start)
    torch.testing.assert_close(field.accelerate(q, v, force), torch.linalg.solve(start, force.T).T)


def test_a_map_is_inverted_and_a_folded_one_has_no_latents() -> None:
    coordinates = PolynomialMap(2, degree=3, ball=make_wide_ball(2, 2.0))
    q, v = torch.randn(2, 50, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(coordinates.invert(q), q)
    with torch.no_grad():
        coordinates.coefficients.copy_(0.02 * torch.randn(7, 2, generator=torch.Generator().manual_seed(1)))
    x, w = coordinates.push(q, v)
    torch.testing.assert_close(coordinates.invert(x), q)
    torch.testing.assert_close(coordinates.invert(x, q + 0.1), q)
    straight = PolynomialMap(2, degree=1, ball=make_wide_ball(2))
    torch.testing.assert_close(straight.invert(x, q), x)
    ahead, behind = (coordinates.evaluate(q + sign * 1e-4 * v)[0] for sign in (1, -1))
    torch.testing.assert_close((ahead - behind) / 2e-4, w, rtol=1e-5, atol=1e-6)
    bending = (ahead - 2.0 * x + behind) / 1e-8
    torch.testing.assert_close(bending, coordinates.measure_bending(q, v), rtol=1e-4, atol=1e-3)
    with torch.no_grad():
        coordinates.coefficients[0] = torch.tensor([-0.5, 0.0])  # x = q - q^2 / 2 has no latent at x = 0.9
    assert coordinates.invert(torch.tensor([[0.9, 0.0]]).double()).isnan().any()


def test_a_map_that_stretches_everywhere_is_one_to_one_far_outside_the_data() -> None:
    coordinates = PolynomialMap(3, degree=2, ball=make_wide_ball(3, 2.0))
    generator = torch.Generator().manual_seed(0)
    directions = torch.randn(6, 3, dtype=torch.float64, generator=generator)
    q = 4.0 * torch.randn(500, 3, dtype=torch.float64, generator=generator)
    folded = 0
    for size in (0.02, 0.05, 0.1, 0.3):
        with torch.no_grad():
            coordinates.coefficients.copy_(size * directions)
        determinants = torch.linalg.det(coordinates.evaluate(q)[1])
        if coordinates.measure_least_stretch() > 0.0:
            assert determinants.min() > 0.0
            torch.testing.assert_close(coordinates.invert(coordinates.evaluate(q)[0]), q)
        else:
            folded += 1
    assert 0 < folded < 4
    assert determinants.min() < 0.0


def test_a_law_in_mapped_coordinates_is_the_same_motion() -> None:
    """A linear oscillator in ``x``, its law in latents ``q`` with ``x = g(q)``."""
    lagrangian = random_lagrangian(2, 1, 0, amount=0.0, terms="polynomial", map_degree=2)
    plain = random_lagrangian(2, 1, 0, amount=0.0, terms="polynomial")
    with torch.no_grad():
        lagrangian.coordinates.coefficients.copy_(0.01 * torch.arange(6).reshape(3, 2))
    lagrangian.longest_step = plain.longest_step = 0.02
    q, v = torch.randn(2, 4, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    u = torch.ones(4, 30, 1, dtype=torch.float64)
    coordinates = lagrangian.coordinates
    found, _ = rollout(lagrangian, q, v, u, dt_s=0.01)
    wanted, _ = rollout(plain, *coordinates.push(q, v), u, dt_s=0.01)
    torch.testing.assert_close(
        coordinates.evaluate(found.flatten(0, 1))[0], wanted.flatten(0, 1), rtol=1e-5, atol=1e-6
    )
    modes, plain_modes = (linearize_modes(each, torch.zeros(1).double()) for each in (lagrangian, plain))
    assert modes.frequency_hz == pytest.approx(plain_modes.frequency_hz, rel=1e-6)
    assert modes.decay_per_s == pytest.approx(plain_modes.decay_per_s, rel=1e-6)
