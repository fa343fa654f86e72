"""Error stages of simulators that are right, that lack a force, and of images that got worse."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from lagsplat.diagnose.residual.error_budget import (
    assess_perception,
    forecast_positions,
    measure_error_stages,
)
from lagsplat.diagnose.residual.latent_force import estimate_latent_force
from tests.unit.diagnose.mechanisms import Duffing, TwoLink, film


def swing(t):
    return np.sin(2.3 * t)


@pytest.fixture(scope="module")
def nominal():
    motion = film(Duffing(), 16.0, inputs=swing, noise=0.01, finer=2)
    return estimate_latent_force(Duffing(), [motion], period_s=1.0)


@pytest.fixture(scope="module")
def real():
    motion = film(
        Duffing(), 16.0, inputs=swing, noise=0.01, finer=2, force=lambda t, q, v, u: -8.0 * q, seed=1
    )
    return estimate_latent_force(Duffing(), [motion], period_s=1.0)


def test_a_forecast_is_that_of_another_integrator():
    rng = np.random.default_rng(0)
    q, v = rng.uniform(-0.5, 0.5, (2, 3, 2))
    times = np.cumsum(rng.uniform(0.02, 0.06, (3, 12)), axis=1)
    path = forecast_positions(TwoLink(), q, v, times, np.zeros((3, 12, 0)), finest_s=0.01)

    def slope(t, x):
        return np.concatenate([x[2:], TwoLink().acceleration(x[:2], x[2:], np.zeros(0))])

    for i in range(3):
        exact = (
            solve_ivp(slope, times[i, [0, -1]], [*q[i], *v[i]], t_eval=times[i], rtol=1e-10, atol=1e-12)
            .y[:2]
            .T
        )
        np.testing.assert_allclose(path[i], exact, atol=1e-7)


def test_a_forecast_without_bounds_ends_in_infinity_and_still_counts():
    runaway = Duffing(hard=-1e6, n_u=0)
    q = np.full((1, 1), 2.0)
    path = forecast_positions(runaway, q, q, np.linspace(0, 1, 30)[None], np.zeros((1, 30, 0)), finest_s=0.1)
    assert np.isinf(path[0, -1, 0])


def test_the_gap_shows_in_the_rollout_and_not_in_the_chart(nominal, real):
    chart, _, rollout = measure_error_stages(Duffing(), real, nominal, horizon_s=1.0)
    assert rollout.low <= rollout.value <= rollout.high
    assert rollout.low > 3.0 * rollout.floor
    own = measure_error_stages(Duffing(), nominal, None, horizon_s=1.0)[-1]
    assert own.floor is None
    assert own.value == pytest.approx(rollout.floor)
    assert chart.value == pytest.approx(chart.floor, rel=0.2)
    assert chart.value == pytest.approx(0.01, rel=0.2)


def test_gaps_grow_with_the_horizon(real):
    stages = [measure_error_stages(Duffing(), real, None, horizon_s=h) for h in (0.25, 0.5, 1.0)]
    values = [rollout.value for _, _, rollout in stages]
    assert values == sorted(values)
    assert stages[0][1].value < values[0]
    too_far = measure_error_stages(Duffing(), real, None, horizon_s=60.0)
    assert [stage.name for stage in too_far] == ["chart", "one step"]


def test_pictures_are_judged_by_the_nominal_ones(real):
    rng = np.random.default_rng(1)
    cloud, same = rng.standard_normal((2, 2000, 2))
    errors = rng.uniform(0.5, 1.5, 2000)
    alike = assess_perception(errors, errors[::-1], same, cloud)
    assert not alike.suspect
    assert alike.ratio == pytest.approx(1.0)
    assert alike.outside < 0.01
    assert assess_perception(errors, errors, same + np.array([8.0, 0.0]), cloud).suspect
    assert assess_perception(3.0 * errors, errors, same, cloud).suspect
    with pytest.raises(ValueError, match="without any error"):
        assess_perception(errors, 0.0 * errors, same, cloud)
    images = (4.0 * errors, errors)
    first = measure_error_stages(Duffing(), real, None, horizon_s=1.0, image_errors=images, block=100)[0]
    assert first.name == "perception"
    assert first.value == pytest.approx(2.0 * first.floor)
