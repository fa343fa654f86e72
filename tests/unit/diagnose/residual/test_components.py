"""Shares of groups of features, memory, and correlations with single signals."""

from dataclasses import replace

import numpy as np
import pytest

from lagsplat.diagnose.core.config import RESIDUAL_REGRESSION
from lagsplat.diagnose.residual.components import compute_components
from lagsplat.diagnose.residual.features import FEATURE_GROUPS, compute_features
from tests.unit.diagnose.mechanisms import Duffing
from tests.unit.diagnose.residuals import made

MECHANISM = Duffing(hard=0.0)


def components_of(residual, **kinds):
    one = made(residual, **kinds)
    return compute_features(MECHANISM, [one], period_s=1.0)


def largest(residual) -> str:
    shares = compute_components(components_of(residual), np.ones(1))
    return max(FEATURE_GROUPS, key=lambda name: shares[name])


@pytest.mark.parametrize(
    ("residual", "group"),
    [
        (lambda t, q, v, u: -2.0 * q**3, "conservative"),
        (lambda t, q, v, u: 1.0 + 0.0 * q, "conservative"),
        (lambda t, q, v, u: -0.4 * v, "dissipative"),
        (lambda t, q, v, u: -np.sign(v), "dissipative"),
        (lambda t, q, v, u: np.clip(u, -0.5, 0.5), "actuation"),
        (lambda t, q, v, u: 0.2 * t + 0.0 * q, "exogenous"),
    ],
)
def test_each_group_is_found(residual, group):
    assert largest(residual) == group


def test_shares_are_a_division_of_the_whole():
    features = components_of(lambda t, q, v, u: -0.2 * v - 0.5 * q**3 + 0.5 * u)
    shares = compute_components(features, np.ones(1))
    assert sum(shares.values()) == pytest.approx(1.0)
    assert min(shares.values()) >= 0.0
    assert set(shares) == {*FEATURE_GROUPS, "unexplained"}
    assert shares["unexplained"] < 0.1


def test_noise_is_unexplained():
    for seed in range(10):
        features = components_of(lambda t, q, v, u: 0.0 * q, seed=seed)
        shares = compute_components(features, np.ones(1))
        assert shares["unexplained"] > 0.8
    shares = compute_components(features, np.zeros(1))
    assert shares["unexplained"] == 1.0


def test_features_that_know_nothing_explain_nothing_on_left_out_blocks():
    found = components_of(lambda t, q, v, u: -0.4 * v)
    (columns,) = found.groups
    noise = np.random.default_rng(0).standard_normal((len(found.target), 20))
    useless = replace(found, groups=(dict.fromkeys(columns, noise[:, :0]) | {"actuation": noise},))
    assert compute_components(useless, np.ones(1))["unexplained"] > 0.95
    assert set(found.fold) == set(range(RESIDUAL_REGRESSION.folds))
