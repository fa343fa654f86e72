"""The written-out acceleration against automatic differentiation and closed forms."""

import math

import pytest
import torch
from torch import Tensor, nn
from torch.autograd.functional import jacobian

from lagsplat.stage2.lagrangian import Coefficients, Floors, Lagrangian
from tests.stage2_problems import form, random_lagrangian


def euler_lagrange(lagrangian: Lagrangian, q: Tensor, v: Tensor, u: Tensor) -> Tensor:
    """Acceleration of one state from the Lagrangian itself, by automatic differentiation."""

    def kinetic(q: Tensor, v: Tensor) -> Tensor:
        return 0.5 * v @ lagrangian.mass(q[None])[0] @ v

    def potential(q: Tensor) -> Tensor:
        return lagrangian.potential(q[None])[0] - (lagrangian.volume(q[None])[0] * u).sum()

    gradient = jacobian(lambda x: kinetic(x, v) - potential(x), q)
    # momentum is M v: its rate along v at fixed v is (dM/dt) v
    transported = jacobian(lambda x: lagrangian.mass(x[None])[0] @ v, q) @ v
    friction = lagrangian.damping(q[None])[0] @ v
    return torch.linalg.solve(lagrangian.mass(q[None])[0], gradient - transported - friction)


@pytest.mark.parametrize(
    ("d", "n_inputs", "changes"),
    [
        (4, 4, {}),
        (3, 0, {}),
        (1, 2, {}),
        (4, 2, {"potential": "icnn", "mass": "constant"}),
        (2, 1, {"potential": "quadratic", "actuation": "linear", "damping": "constant"}),
        (3, 2, {"mass": "induced"}),
        (1, 0, {"terms": "polynomial"}),
        (3, 2, {"terms": "polynomial", "matrix_degree": 2}),
    ],
)
def test_acceleration_is_the_euler_lagrange_equation(d: int, n_inputs: int, changes: dict) -> None:
    lagrangian = random_lagrangian(d, n_inputs, 3, **changes)
    q, v = torch.randn(2, 5, d, dtype=torch.float64)
    u = torch.rand(5, n_inputs, dtype=torch.float64)
    got = lagrangian.acceleration(q, v, u)
    for i in range(5):
        torch.testing.assert_close(got[i], euler_lagrange(lagrangian, q[i], v[i], u[i]), rtol=1e-9, atol=1e-9)


class DoublePendulumMass(nn.Module):
    """Inertia of two unit point masses on unit rods, with its velocity forces in closed form."""

    def matrix(self, q: Tensor) -> Tensor:
        c = torch.cos(q[:, 0] - q[:, 1])
        return torch.stack([torch.stack([2 + 0 * c, c], 1), torch.stack([c, 1 + 0 * c], 1)], 1)


def test_written_inertia_matches_that_of_a_double_pendulum() -> None:
    """A field fitted to the double pendulum's mass and slope at a point gives its velocity forces.

    The closed form is ``-sin(a - b) (w_b^2, -w_a^2)``; the formula under test is evaluated on the same M and
    dM/dq through `inertia` of a field fitted exactly at one state by its last layer.
    """
    lagrangian = random_lagrangian(2, 0, 5)
    field = lagrangian.mass_term
    q = torch.tensor([[0.7, -0.4]], dtype=torch.float64)
    v = torch.tensor([[1.3, -0.8]], dtype=torch.float64)
    truth = DoublePendulumMass().matrix
    target = torch.linalg.cholesky(truth(q)[0] - field.floor * torch.eye(2, dtype=torch.float64))
    slopes = jacobian(
        lambda x: torch.linalg.cholesky(truth(x[None])[0] - field.floor * torch.eye(2, dtype=torch.float64)),
        q[0],
    )
    with torch.no_grad():
        field.factor.copy_(torch.eye(2, dtype=torch.float64))
        _, h2 = field._hidden(q)
        rates = jacobian(lambda x: field._hidden(x[None])[1][0], q[0])
        known = torch.cat([h2, rates.T], 0)
        wanted = torch.cat([(target - torch.eye(2)).reshape(1, 4), slopes.reshape(4, 2).T], 0)
        field.third.copy_(torch.linalg.lstsq(known, wanted, driver="gelsd").solution.T)
    mass, force = field.inertia(q, v)
    torch.testing.assert_close(mass, truth(q), rtol=1e-9, atol=1e-9)
    a, b = q[0]
    wa, wb = v[0]
    closed = -torch.sin(a - b) * torch.stack([wb**2, -(wa**2)])
    torch.testing.assert_close(force[0], closed, rtol=1e-8, atol=1e-8)


def test_constant_system_is_the_damped_oscillator() -> None:
    """``q(t) = e^{-zeta t} cos(omega_d t)`` satisfies the acceleration at every instant."""
    start = Coefficients(
        torch.tensor([[2.0]], dtype=torch.float64),
        torch.tensor([[0.4]], dtype=torch.float64),
        torch.tensor([[8.0]], dtype=torch.float64),
        torch.zeros(0, 1, dtype=torch.float64),
        torch.zeros(1, dtype=torch.float64),
    )
    lagrangian = Lagrangian(
        start,
        form=form(potential="quadratic", damping="constant", mass="constant", actuation="linear"),
        floors=Floors(0.01, 0.01, 0.01),
        time_unit_s=1.0,
        seed=0,
    )
    rate, omega = 0.1, math.sqrt(4.0 - 0.01)
    t = torch.linspace(0, 3, 7, dtype=torch.float64)
    e = torch.exp(torch.complex(-rate * t, omega * t))
    s = complex(-rate, omega)
    q, v, a = e.real, (s * e).real, (s * s * e).real
    got = lagrangian.acceleration(q[:, None], v[:, None], torch.zeros(7, 0, dtype=torch.float64))
    torch.testing.assert_close(got[:, 0], a, rtol=1e-10, atol=1e-10)
