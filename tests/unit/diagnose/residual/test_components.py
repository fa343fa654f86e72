"""Shares of groups of features, memory, measurement errors, and correlations with single signals."""

import numpy as np
import pytest

from lagsplat.diagnose.core.config import RESIDUAL_REGRESSION
from lagsplat.diagnose.residual.components import (
    compute_components,
    compute_explained_share,
    compute_residual_correlations,
)
from lagsplat.diagnose.residual.features import FEATURE_GROUPS, compute_features
from lagsplat.diagnose.residual.latent_force import estimate_latent_force
from lagsplat.diagnose.residual.measurement_model import compute_apparent_forces, measure_speed_noise
from lagsplat.io.trajectory.trajectory import Trajectory
from tests.unit.diagnose.mechanisms import Duffing, TwoLink, film
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
    rng = np.random.default_rng(0)
    assert compute_explained_share(found, 0, rng.standard_normal((len(found.target), 20))) < 0.05
    assert compute_explained_share(found, 0, found.groups[0]["dissipative"]) > 0.9
    assert set(found.fold) == set(range(RESIDUAL_REGRESSION.folds))


def test_bent_positions_feign_the_force_that_the_smoother_finds():
    clean = film(TwoLink(), 8.0, start=(0.6, -0.4), finer=4)
    bend = 0.05 * clean.q**2 * np.array([1.0, 0.0])
    bent = Trajectory(time_s=clean.time_s, q=clean.q + bend, u=clean.u)
    smoothed = estimate_latent_force(TwoLink(), [bent], period_s=1.6)
    for i in (0, 1):
        expected = 0.05 * compute_apparent_forces(TwoLink(), smoothed, i)[30:-30, 0]
        found = smoothed[0].residual[30:-30, i]
        assert np.corrcoef(expected, found)[0, 1] > 0.9
        assert np.std(found) == pytest.approx(np.std(expected), rel=0.25)


def test_noise_that_grows_with_speed_is_told_from_noise_that_does_not():
    even = [made(lambda t, q, v, u: 0.0 * q, seed=seed) for seed in range(100)]
    told = sum(measure_speed_noise([one], period_s=1.0, seed=7).p < 0.05 for one in even)
    assert told <= 11
    one = even[0]
    late = 0.02 * one.v * np.random.default_rng(0).standard_normal(one.v.shape)
    worse = type(one)(**{**vars(one), "innovation": one.innovation * 0.1 + late})
    found = measure_speed_noise([worse], period_s=1.0)
    assert found.p < 0.01
    assert found.share > 0.3


LAWS = {
    "u0": lambda t, q, v, u: 0.5 * u,
    "q³": lambda t, q, v, u: 0.5 * q**3,
    "v": lambda t, q, v, u: -0.3 * v,
    "sign v": lambda t, q, v, u: -0.3 * np.sign(v),
    "|v| v": lambda t, q, v, u: -0.02 * np.abs(v) * v,
}


def score_row(smoothed):
    found = compute_residual_correlations(smoothed, q_names=["q0"], u_names=["u0"])
    return dict(zip(found.regressors, found.score[0], strict=True))


@pytest.mark.parametrize("name", sorted(LAWS))
def test_the_law_behind_the_residual_leads_or_nearly_so(name):
    scores = score_row([made(LAWS[name])])
    assert scores[name] > 0.85 * max(scores.values())  # v and |v| v are much alike
    assert scores[name] > 1.0


def test_chance_passes_the_bound_as_often_as_the_bound_says():
    scores = np.array(
        [list(score_row([made(lambda t, q, v, u: 0.0 * q, seed=k)]).values()) for k in range(60)]
    )
    assert 0.01 < np.mean(scores > 1.0) < 0.10


def test_clips_are_not_glued():
    first, second = made(LAWS["sign v"], seed=1), made(LAWS["sign v"], seed=2)
    assert score_row([first, second])["sign v"] > score_row([first])["sign v"]


def test_a_silent_coordinate_and_a_constant_input_score_nothing():
    silent = made(LAWS["v"], coordinates=2, quiet=(1,))
    silent.motion.u[:] = 3.0
    found = compute_residual_correlations([silent], q_names=["a", "b"], u_names=["u0"])
    assert not found.score[1].any()
    assert not found.score[:, :2].any()
    assert found.coordinates == ("a", "b")
