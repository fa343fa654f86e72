"""Residuals of a mass against the one that is expected, and their derivatives."""

import math

import numpy as np
import pytest
import torch
from torch.autograd.functional import jacobian

from lagsplat.stage2.likelihood.mass_prior import DEVIATION, MASS, WITHIN, MassPrior
from lagsplat.stage2.likelihood.parameter_vector import ParameterVector
from tests.stage2_problems import random_lagrangian


def make_prior(expected: torch.Tensor) -> tuple[MassPrior, ParameterVector, torch.Tensor]:
    parameters = ParameterVector(
        random_lagrangian(len(expected), 1, 3, amount=0.05, terms="polynomial", map_degree=2)
    )
    theta = parameters.read()
    return MassPrior(parameters, expected), parameters, theta


def with_mass(parameters: ParameterVector, theta: torch.Tensor, mass: torch.Tensor) -> torch.Tensor:
    floor = parameters.terms[1].floor
    factor = torch.linalg.cholesky(mass - floor * torch.eye(len(mass)).double())
    changed = theta.clone()
    changed[parameters.find_columns(MASS)] = factor.flatten()
    return changed


def test_any_multiple_of_the_expected_mass_has_no_residual() -> None:
    expected = torch.tensor([[2.0, 0.5], [0.5, 1.0]]).double()
    prior, parameters, theta = make_prior(expected)
    residual, _ = prior.measure(with_mass(parameters, theta, 7.0 * expected))
    assert float(residual.abs().max()) < 1e-9


def test_a_factor_between_two_directions_counts_as_much_as_its_reciprocal() -> None:
    expected = torch.eye(2).double()
    prior, parameters, theta = make_prior(expected)
    costs = []
    for ratio in (WITHIN, 1.0 / WITHIN):
        mass = torch.diag(torch.tensor([1.0, ratio]).double())
        costs.append(float(prior.measure(with_mass(parameters, theta, mass))[0].square().sum()))
    assert costs[0] == pytest.approx(costs[1])
    small = math.exp(0.1 * DEVIATION)
    mass = torch.diag(torch.tensor([small, 1.0 / small]).double())
    cost = float(prior.measure(with_mass(parameters, theta, mass))[0].square().sum())
    assert cost == pytest.approx(2 * 0.1**2, rel=0.02)


def test_derivatives_are_those_of_the_residuals() -> None:
    prior, _, theta = make_prior(torch.tensor([[2.0, 0.5], [0.5, 1.0]]).double())
    _, rows = prior.measure(theta)
    expected = jacobian(lambda x: prior.measure(x)[0], theta)
    torch.testing.assert_close(rows, expected)
    assert np.isfinite(rows.numpy()).all()
