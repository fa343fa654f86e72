"""The hidden force against forces that were put in, and its likelihood against differences."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from lagsplat.diagnose.mechanics.model import compute_rest_frequencies_hz
from lagsplat.diagnose.residual.latent_force import estimate_latent_force
from lagsplat.diagnose.residual.linearization import StatePath, compute_kinematic_steps, linearize_steps
from lagsplat.diagnose.residual.state_space import (
    ForceVariances,
    SmootherData,
    _build_model,
    compute_log_likelihood,
    maximize_likelihood,
    smooth_path,
)
from lagsplat.io.trajectory.trajectory import Trajectory
from tests.unit.diagnose.mechanisms import Chain, Duffing, TwoLink, film


def swing(t):
    return np.sin(2 * np.pi * 0.37 * t)


def smooth_push(t, q, v, u):
    return np.array([6.0 * np.exp(-0.5 * ((t - 5.0) / 0.2) ** 2)])


def small_record() -> SmootherData:
    rng = np.random.default_rng(0)
    h = rng.uniform(0.01, 0.03, 40)
    starts = np.zeros(40, dtype=bool)
    starts[[0, 23]] = True
    h[[22, 39]] = 0.0
    y = np.cumsum(rng.standard_normal((40, 2)), axis=0)
    return SmootherData(y, starts, h, y.std(axis=0), 0.2)


def test_slope_of_the_likelihood_is_its_difference():
    record = small_record()
    chain = _build_model(record, compute_kinematic_steps(record.h, 2), 0.3)
    values = np.array([0.3, 2.0, 0.01, 0.2])
    score = chain.differentiate(chain.filter(values))
    for i in range(4):
        step = 1e-5 * values[i] * np.eye(4)[i]
        up, down = (compute_log_likelihood(chain.filter(values + sign * step)) for sign in (1.0, -1.0))
        numeric = (up - down) / (2e-5 * values[i])
        assert score[i] == pytest.approx(numeric, rel=1e-4, abs=1e-6)


def test_smoother_is_the_posterior_of_one_large_gaussian():
    """An independent oracle: the joint covariance of all states and measurements, conditioned at once."""
    record = small_record()
    values = np.array([0.3, 2.0, 0.01, 0.2])
    chain = _build_model(record, compute_kinematic_steps(record.h, 2), 0.3)
    clip = slice(0, 23)
    n = chain.transition.shape[1]
    rate = np.sqrt(3.0) / 0.3 * record.unit_s
    start = np.concatenate([np.ones(2), np.full(2, 25.0), values[:2], rate**2 * values[:2]])
    joint = np.zeros((23 * n, 23 * n))
    joint[:n, :n] = np.diag(start)
    for t in range(1, 23):
        a = chain.transition[t]
        row, past = slice(t * n, t * n + n), slice(0, t * n)
        joint[row, past] = a @ joint[(t - 1) * n : t * n, past]
        joint[past, row] = joint[row, past].T
        noise = np.zeros((n, n))
        for i in range(2):
            pair = [4 + i, 6 + i]
            noise[np.ix_(pair, pair)] = chain.drive[t] * values[i]
        joint[row, row] = a @ joint[(t - 1) * n : t * n, (t - 1) * n : t * n] @ a.T + noise
    see = np.kron(np.eye(23), np.eye(2, n))
    y = chain.y[clip].ravel()
    mean = np.zeros(23 * n)
    for t in range(23):
        before = np.concatenate([chain.y[0], np.zeros(n - 2)]) if t == 0 else mean[(t - 1) * n : t * n]
        mean[t * n : t * n + n] = before if t == 0 else chain.transition[t] @ before
    white = np.diag(np.tile(values[2:], 23))
    gain = joint @ see.T @ np.linalg.inv(see @ joint @ see.T + white)
    expected = (mean + gain @ (y - see @ mean)).reshape(23, n) * chain.units
    covariance = joint - gain @ see @ joint
    found = smooth_path(record, compute_kinematic_steps(record.h, 2), ForceVariances(0.3, values))
    np.testing.assert_allclose(found.q[clip], expected[:, :2], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(found.force[clip], expected[:, 4:6], rtol=1e-5, atol=1e-5)
    at = slice(11 * n + 4, 11 * n + 6)
    np.testing.assert_allclose(
        found.covariance[11], covariance[at, at] * np.outer(chain.units[4:6], chain.units[4:6]), rtol=1e-5
    )


@pytest.mark.parametrize(("beside", "error"), [(0.0, 2e-7), (1e-3, 1e-4), (1e-2, 2e-3)])
def test_a_linear_step_is_that_of_a_finer_integrator(beside, error):
    """On the path it is exact, and beside it the error is of second order."""
    mechanism = TwoLink()
    rng = np.random.default_rng(3)
    q, v = rng.uniform(-1, 1, (2, 4, 2))
    r = rng.uniform(-2, 2, (4, 1, 2)) * np.ones((1, 3, 1))
    push = np.linalg.solve(mechanism.mass_at(q), (mechanism.rest_inertia * r[:, 0])[..., None])[..., 0]
    a = mechanism.acceleration(q, v, np.zeros((4, 0))) + push
    later = [q + h * v + 0.5 * h**2 * a for h in (0.005, 0.01)]
    path = StatePath(np.full(4, 0.01), q, v, *later, np.zeros((4, 3, 0)), r)
    steps = linearize_steps(mechanism, path, scale=np.ones(2), period_s=0.05)
    move = beside * rng.standard_normal((4, 4))

    def slope(t, x, force):
        push = np.linalg.solve(mechanism.mass_at(x[:2]), mechanism.rest_inertia * force)
        return np.concatenate([x[2:], mechanism.acceleration(x[:2], x[2:], np.zeros(0)) + push])

    for i in range(4):
        state = np.concatenate([q[i], v[i]]) + move[i]
        force = r[i, 0] + beside
        exact = solve_ivp(slope, (0, 0.01), state, args=(force,), rtol=1e-11, atol=1e-12).y[:, -1]
        linear = steps.phi[i] @ state + np.einsum("jab,b->a", steps.gamma[i], force) + steps.offset[i]
        np.testing.assert_allclose(linear, exact, atol=error)


def test_a_push_is_found_in_size_and_time_with_honest_uncertainty():
    motion = film(Duffing(), 20.0, force=smooth_push, inputs=swing, noise=0.01)
    (found,) = estimate_latent_force(Duffing(), [motion], period_s=1.0)
    true = np.array([smooth_push(t, 0, 0, 0)[0] for t in motion.time_s]) / 2.0
    assert motion.time_s[np.argmax(found.residual)] == pytest.approx(5.0, abs=0.05)
    assert found.residual.max() == pytest.approx(3.0, rel=0.1)
    score = (found.residual[:, 0] - true) / found.std[:, 0]
    assert 0.3 < np.sqrt(np.mean(score**2)) < 1.3
    assert found.noise[0] == pytest.approx(0.01 * motion.q.std(), rel=0.1)
    assert np.mean((found.q - film(Duffing(), 20.0, force=smooth_push, inputs=swing).q) ** 2) < (
        0.3 * found.noise[0] ** 2
    )


def test_acceleration_balances_force_and_residual():
    motion = film(TwoLink(), 5.0, start=(0.3, 0.2), noise=0.01)
    (found,) = estimate_latent_force(TwoLink(), [motion], period_s=1.6)
    inertial = np.einsum("nij,nj->ni", TwoLink().mass_at(found.q), found.a)
    lacking = inertial - TwoLink().force(found.q, found.v, motion.u)
    np.testing.assert_allclose(lacking, found.residual * TwoLink().rest_inertia, atol=1e-9)


@pytest.mark.parametrize("mechanism", [Duffing(), Duffing(n_u=0)], ids=["forced", "free"])
def test_nothing_is_found_where_nothing_is(mechanism):
    found = []
    for seed in range(24):
        motion = film(mechanism, 8.0, inputs=swing if mechanism.n_u else None, noise=0.02, seed=seed, finer=2)
        (one,) = estimate_latent_force(mechanism, [motion], period_s=1.0)
        found.append(one.active[0])
    assert np.sum(found) <= 2


def test_the_force_stays_in_its_coordinate():
    def friction(t, q, v, u):
        return np.array([0.0, -0.05 * np.tanh(v[1] / 0.02)])

    motion = film(TwoLink(), 12.0, start=(0.3, 0.4), force=friction, noise=0.005)
    (found,) = estimate_latent_force(TwoLink(), [motion], period_s=1.6)
    rms = np.sqrt(np.mean(found.residual**2, axis=0))
    assert rms[0] < 0.1 * rms[1]
    true = -0.05 * np.tanh(found.v[:, 1] / 0.02) / TwoLink().rest_inertia[1]
    assert np.corrcoef(found.residual[:, 1], true)[0, 1] > 0.95


def test_uneven_samples_and_cuts_are_respected():
    rng = np.random.default_rng(1)
    times = np.cumsum(rng.uniform(0.008, 0.03, 600))
    even = film(Duffing(n_u=0), 6.0, times=times, noise=0.005)
    again = Trajectory(
        time_s=np.concatenate([even.time_s, even.time_s + 20.0]),
        q=np.concatenate([even.q, even.q]),
        u=np.zeros((1200, 0)),
        segments=((0, 600), (600, 1200)),
    )
    (found,) = estimate_latent_force(Duffing(n_u=0), [again], period_s=1.0)
    assert np.sqrt(np.mean(found.residual**2)) < 0.01 * np.std(found.a)
    np.testing.assert_allclose(found.q[:600], found.q[600:], atol=1e-9)


def test_frequencies_from_the_equations():
    assert compute_rest_frequencies_hz(Duffing(), np.ones(1)) == pytest.approx([1.0], rel=1e-5)
    slowest = np.sqrt(90.0 * (2 - 2 * np.cos(np.pi / 5))) / (2 * np.pi)
    assert compute_rest_frequencies_hz(Chain(), np.full(4, 0.3))[0] == pytest.approx(slowest, rel=1e-6)
    assert not compute_rest_frequencies_hz(Duffing(k=-3.0, hard=0.0), np.ones(1)).size


def test_what_is_not_pulled_back_is_smoothed_all_the_same():
    """A slider on a rail: no natural period, and so as fine as the given one asks for."""
    slider = Duffing(k=0.0, hard=0.0)
    motion = film(slider, 5.0, inputs=swing, noise=0.01)
    (found,) = estimate_latent_force(slider, [motion], period_s=1.0)
    clean = film(slider, 5.0, inputs=swing)
    assert np.sqrt(np.mean((found.q - clean.q) ** 2)) < 0.5 * found.noise[0]


def test_wrong_columns_and_stillness_are_refused():
    motion = film(Duffing(n_u=0), 2.0)
    with pytest.raises(ValueError, match="1 coordinates and 0 inputs, but the sim has 1 and 1"):
        estimate_latent_force(Duffing(), [motion], period_s=1.0)
    still = Trajectory(time_s=motion.time_s, q=np.ones((motion.n, 1)), u=motion.u)
    with pytest.raises(ValueError, match="stand still"):
        estimate_latent_force(Duffing(n_u=0), [still], period_s=1.0)


def test_likelihood_rises_to_its_maximum():
    record = small_record()
    steps = compute_kinematic_steps(record.h, 2)
    start = ForceVariances(0.3, np.array([1.0, 1.0, 0.01, 0.01]))
    best = maximize_likelihood(record, steps, start)
    for factor in (0.8, 1.25):
        for i in range(4):
            moved = best.values * np.where(np.arange(4) == i, factor, 1.0)
            filtered = _build_model(record, steps, 0.3).filter(moved)
            assert compute_log_likelihood(filtered) <= best.log_likelihood + 1e-6
