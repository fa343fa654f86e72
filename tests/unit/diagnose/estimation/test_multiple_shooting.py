"""Multiple shooting on predictions that are written down here."""

import numpy as np
import pytest

from lagsplat.diagnose.estimation.multiple_shooting import (
    GaussianPrior,
    ShootingData,
    compute_penalty,
    differentiate_predictions,
    eliminate_starts,
    fit_multiple_shooting,
)

T = 0.05 * np.arange(40)


def swings(x: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """``a = -w^2 q - 2 g v`` in closed form, of parameters (w, g) and starts (q, v)."""
    w, g = x[:, 0, None, None], x[:, 1, None, None]
    q, v = starts[..., 0, None], starts[..., 1, None]
    fast = np.sqrt(w**2 - g**2)
    return (np.exp(-g * T) * (q * np.cos(fast * T) + (v + g * q) / fast * np.sin(fast * T)))[..., None]


def problem(noise: float = 0.0) -> tuple[np.ndarray, np.ndarray, ShootingData]:
    rng = np.random.default_rng(0)
    truth, starts = np.array([5.0, 0.4]), rng.normal(0.0, 1.0, (6, 2))
    y = swings(truth[None], starts[None])[0] + noise * rng.normal(size=(6, 40, 1))
    weight = np.full(y.shape, 1.0 / max(noise, 0.01))
    weight[2, 25:] = 0.0  # a shorter window
    y[2, 25:] = 1e3
    return truth, starts, ShootingData(y, weight, np.full(2, 1e-5))


def weak(n: int = 2) -> GaussianPrior:
    return GaussianPrior(np.zeros(n), np.full(n, 1e3), np.full(n, -np.inf), np.full(n, 1e-5))


def test_parameters_and_starting_states_are_recovered() -> None:
    truth, starts, data = problem()
    fit = fit_multiple_shooting(
        swings, np.array([4.5, 0.1]), starts + 0.1, data, weak(), iterations=30, tolerance=1e-10
    )
    assert fit.x == pytest.approx(truth, rel=1e-5)
    assert np.abs(fit.starts - starts).max() < 1e-5
    assert fit.misfit < 1e-6
    assert fit.misfit == pytest.approx(float((fit.residual**2).sum()))


def test_under_noise_the_misfit_is_the_freedom_and_the_curvature_is_the_inverse_of_the_scatter() -> None:
    truth, starts, data = problem(noise=0.02)
    found, misfits = [], []
    for seed in range(25):
        noisy = data.y + 0.02 * np.random.default_rng(100 + seed).normal(size=data.y.shape)
        noisy -= data.y - swings(truth[None], starts[None])[0]
        fit = fit_multiple_shooting(
            swings,
            truth,
            starts,
            ShootingData(noisy, data.weight, data.start_step),
            weak(),
            iterations=15,
            tolerance=1e-8,
        )
        found.append(fit.x)
        misfits.append(fit.misfit)
    freedom = (data.weight > 0).sum() - 12 - 2
    assert np.mean(misfits) == pytest.approx(freedom, rel=0.05)
    spread = np.sqrt(np.diag(np.linalg.inv(fit.curvature)))
    assert np.std(found, axis=0) == pytest.approx(spread, rel=0.4)


def test_eliminating_the_starts_solves_the_dense_equations() -> None:
    """Schur complement, its determinant and the step against one large system."""
    rng = np.random.default_rng(0)
    slopes, begun = rng.normal(size=(4, 9, 3)), rng.normal(size=(4, 9, 2))
    residual = rng.normal(size=(4, 9, 1))
    left = eliminate_starts(residual, slopes, begun)
    curvature, log_det = left.curvature, left.log_determinant
    dense = np.zeros((4, 9, 3 + 8))
    dense[..., :3] = slopes
    for w in range(4):
        dense[w, :, 3 + 2 * w : 5 + 2 * w] = begun[w]
    a = dense.reshape(36, 11)
    gram, pull = a.T @ a, a.T @ residual.ravel()
    step = np.linalg.solve(gram, pull)
    assert np.linalg.solve(curvature, left.right) == pytest.approx(step[:3], rel=1e-8)
    assert left.follow(step[:3]).ravel() == pytest.approx(step[3:], rel=1e-7, abs=1e-9)
    assert np.linalg.slogdet(gram)[1] == pytest.approx(np.linalg.slogdet(curvature)[1] + log_det, rel=1e-8)
    schur = gram[:3, :3] - gram[:3, 3:] @ np.linalg.solve(gram[3:, 3:], gram[3:, :3])
    assert curvature == pytest.approx(schur, rel=1e-8)
    alone = eliminate_starts(residual, slopes[..., :0], begun)
    assert alone.curvature.shape == (0, 0)
    assert alone.follow(np.zeros(0)) == pytest.approx(left.follow(np.zeros(3)))


def test_slopes_are_those_of_central_differences() -> None:
    truth, starts, data = problem()
    step = np.full(2, 1e-6)
    residual, slopes, begun = differentiate_predictions(swings, truth, starts, data, step)
    assert np.abs(residual).max() < 1e-9
    for i in range(2):
        e = 1e-4 * np.eye(2)[i]
        central = (swings((truth + e)[None], starts[None]) - swings((truth - e)[None], starts[None]))[
            0
        ] / 2e-4
        assert slopes[..., i] == pytest.approx((central * data.weight)[..., 0], abs=2e-2)
        central = (swings(truth[None], (starts + e)[None]) - swings(truth[None], (starts - e)[None]))[
            0
        ] / 2e-4
        assert begun[..., i] == pytest.approx((central * data.weight)[..., 0], abs=1e-3)
    first = differentiate_predictions(swings, truth, starts, data, step, leading=1)
    assert np.array_equal(first[0], residual)
    assert first[1][..., 0] == pytest.approx(slopes[..., 0], rel=1e-9)
    assert (first[1].shape[2], first[2].shape[2]) == (1, 0)


def test_a_bound_holds_and_a_belief_pulls() -> None:
    _, starts, data = problem()
    bounded = GaussianPrior(np.zeros(2), np.full(2, 1e3), np.array([-np.inf, 0.6]), np.full(2, 1e-5))
    fit = fit_multiple_shooting(
        swings, np.array([5.0, 0.7]), starts, data, bounded, iterations=20, tolerance=1e-8
    )
    assert fit.x[1] == pytest.approx(0.6)
    sure = GaussianPrior(np.array([5.0, 0.7]), np.array([1e3, 1e-6]), np.full(2, -np.inf), np.full(2, 1e-5))
    fit = fit_multiple_shooting(
        swings, np.array([5.0, 0.7]), starts, data, sure, iterations=20, tolerance=1e-8
    )
    assert fit.x[1] == pytest.approx(0.7, abs=1e-4)
    assert fit.penalty == pytest.approx(float(compute_penalty(fit.x[None], sure)[0]))


def test_slopes_known_from_a_fit_nearby_lead_to_the_same_place() -> None:
    _, starts, data = problem(noise=0.01)
    whole = fit_multiple_shooting(
        swings, np.array([4.8, 0.2]), starts, data, weak(), iterations=30, tolerance=1e-9
    )
    near = (whole.slopes[..., 1:] * 1.02, whole.start_slopes)
    saved = fit_multiple_shooting(
        swings, np.array([4.8, 0.2]), starts, data, weak(), iterations=60, tolerance=1e-9, known=near
    )
    assert saved.x == pytest.approx(whole.x, abs=2e-4)
    assert saved.misfit == pytest.approx(whole.misfit, rel=1e-4)


def test_a_prediction_that_is_not_finite_is_never_stepped_to() -> None:
    truth, starts, data = problem()

    def narrow(x: np.ndarray, s: np.ndarray) -> np.ndarray:
        return np.where((x[:, 0] < 5.2)[:, None, None, None], swings(x, s), np.nan)

    fit = fit_multiple_shooting(
        narrow, np.array([4.2, 0.1]), starts, data, weak(), iterations=40, tolerance=1e-10
    )
    assert fit.x == pytest.approx(truth, rel=1e-3)
