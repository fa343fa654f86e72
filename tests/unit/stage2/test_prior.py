"""Widths of priors by the evidence, against linear regression, where the evidence has a closed form."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from lagsplat.stage2.likelihood.parameter_vector import POTENTIAL, ParameterVector
from lagsplat.stage2.likelihood.prior import ABSENT, Prior, make_prior
from tests.stage2_problems import random_lagrangian

GROUPS = [np.arange(1, 4), np.arange(4, 8)]


def make_regression(sizes: tuple[float, float]) -> tuple[np.ndarray, np.ndarray, Prior]:
    """Rows of unit noise, a parameter that is free, and two groups of weights of the given sizes."""
    rng = np.random.default_rng(0)
    rows = rng.standard_normal((60, 8)) + 0.3
    weights = np.concatenate([[2.0], sizes[0] * rng.standard_normal(3), sizes[1] * rng.standard_normal(4)])
    unit = np.array([1e-2, *[1.0, 4.0, 9.0], *[1.0, 1.0, 2.0, 2.0]])
    prior = Prior(np.zeros(8), unit, GROUPS, np.ones(2))
    return rows, rows @ weights + rng.standard_normal(60), prior


def measure_evidence(rows: np.ndarray, y: np.ndarray, prior: Prior) -> float:
    """Exactly, up to a constant: the logarithm of the density of ``y``."""
    covariance = np.eye(len(y)) + (rows / prior.precision) @ rows.T
    return float(-0.5 * (y @ np.linalg.solve(covariance, y) + np.linalg.slogdet(covariance)[1]))


def test_steps_lead_to_the_relevance_of_largest_evidence() -> None:
    rows, y, prior = make_regression((1.5, 0.4))
    for _ in range(200):
        information = rows.T @ rows + np.diag(prior.precision)
        prior = prior.estimate_relevance(np.linalg.solve(information, rows.T @ y), information)
    reached = measure_evidence(rows, y, prior)
    assert (prior.relevance != ABSENT).all()
    for factor in (0.8, 1.25):
        for i in range(2):
            moved = prior.relevance.copy()
            moved[i] *= factor
            assert measure_evidence(rows, y, replace(prior, relevance=moved)) < reached


def test_a_group_that_explains_nothing_becomes_absent_and_stays_so() -> None:
    rows, y, prior = make_regression((1.5, 0.0))
    rng = np.random.default_rng(3)
    for _ in range(400):
        information = rows.T @ rows + np.diag(prior.precision)
        theta = np.linalg.solve(information, rows.T @ y)
        theta[4:] *= 0.01 * rng.random()  # nothing is left of it
        prior = prior.estimate_relevance(theta, information)
    assert prior.relevance[1] == ABSENT
    assert prior.relevance[0] < 10.0


@pytest.mark.parametrize(("size", "added"), [(0.6, True), (0.0, False)])
def test_an_absent_group_is_added_with_the_gain_that_it_brings(size: float, added: bool) -> None:
    rows, y, prior = make_regression((1.5, size))
    prior = replace(prior, relevance=np.array([1.0, ABSENT]))
    open_prior = prior.without_absent()
    information = rows.T @ rows + np.diag(open_prior.precision)
    present = np.linalg.solve(information[:4, :4], rows[:, :4].T @ y)
    theta = np.concatenate([present, np.zeros(4)])
    right = rows.T @ (y - rows @ theta) - open_prior.precision * theta
    grown = prior.add_group(information, right, least_gain=2.0)
    assert (grown is not None) == added
    if grown is not None:
        assert grown.relevance[0] == 1.0
        best = minimize_scalar(
            lambda x: -measure_evidence(rows, y, replace(prior, relevance=np.array([1.0, 10.0**x]))),
            bounds=(-2.0, 5.0),
            method="bounded",
        )
        gain = measure_evidence(rows, y, grown) - measure_evidence(rows, y, prior)
        assert gain > 2.0
        assert np.log10(grown.relevance[1]) == pytest.approx(best.x, abs=0.5)
        # a gain that is asked for and not there
        assert prior.add_group(information, right, least_gain=gain + 1.0) is None


def test_high_degrees_are_small_and_the_linear_part_is_as_it_was() -> None:
    law = random_lagrangian(1, 1, 0, amount=0.1, terms="polynomial", potential_degree=6, map_degree=3)
    parameters = ParameterVector(law)
    prior, theta = make_prior(parameters), parameters.read().numpy()
    grouped = np.concatenate(prior.groups)
    assert len(np.unique(grouped)) == len(grouped)
    linear = np.setdiff1d(np.arange(len(theta)), grouped)
    assert (prior.mean[linear] == theta[linear]).all()
    assert (prior.mean[grouped] == 0.0).all()
    potential = prior.unit[parameters.list_groups()[POTENTIAL].numpy()]
    # degrees 3 to 6 of a random function with a length scale of three deviations: 3^k sqrt(k!)
    assert potential == pytest.approx([9.0**k * f for k, f in ((3, 6), (4, 24), (5, 120), (6, 720))])
