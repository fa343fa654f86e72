"""Laws that are regressed on encoded states: what each forecasts of motions whose law is known."""

from collections.abc import Callable

import numpy as np
import pytest

from lagsplat.evaluate.latent_regression import fit_gaussian_process, fit_koopman_law, fit_linear_law
from lagsplat.evaluate.protocol import EvaluationSeries, Integrate
from tests.unit.evaluate.driven_motion import DT_S, simulate, swing_pendulum, train_on

LONGEST = 60  # frames ahead


def fit_koopman(train: EvaluationSeries) -> Integrate:
    return fit_koopman_law(train, horizon=LONGEST)


def draw_pushes(seed: int, *, scale: float = 1.0) -> np.ndarray:
    return scale * np.repeat(np.random.default_rng(seed).normal(size=40), 25)[:, None]


def measure_error(
    fit: Callable[[EvaluationSeries], Integrate],
    move: Callable[..., np.ndarray],
    *,
    scale: float,
    start: float,
) -> float:
    """Root mean square error of forecasts under new inputs, over the motion's standard deviation."""
    pushes = draw_pushes(0, scale=scale), draw_pushes(1, scale=scale)
    known, new = (move(u, (start, 0.0)) for u in pushes)
    integrate = fit(train_on(known[:, :1], pushes[0]))
    starts = np.arange(100, 900, 40)
    window = starts[:, None] + np.arange(LONGEST)
    made = integrate(new[starts, :1], new[starts, 1:], pushes[1][window], DT_S)
    return float(np.sqrt(np.square(made[..., 0] - new[window, 0]).mean()) / new[:, 0].std())


def test_the_linear_law_forecasts_a_linear_motion_under_new_inputs() -> None:
    rng = np.random.default_rng(0)
    pushes = [np.repeat(rng.normal(size=40), 25)[:, None] for _ in range(2)]
    known, new = (simulate(u, (1.0, 0.0)) for u in pushes)
    integrate = fit_linear_law(train_on(known[:, :1], pushes[0]))
    after = 200
    made = integrate(new[after : after + 1, :1], new[after : after + 1, 1:], pushes[1][None, after:300], DT_S)
    assert made.shape == (1, 100, 1)
    # velocities of the fit are differences, so it is not exact
    assert np.abs(made[0, :, 0] - new[after:300, 0]).max() < 0.03 * np.abs(new[:, 0]).max()


def test_a_law_that_grows_ends_not_finite_rather_than_in_an_error() -> None:
    q = np.exp(0.3 * np.arange(100.0))[:, None]
    made = fit_linear_law(train_on(q, np.zeros((100, 0))))(q[:2], 15 * q[:2], np.zeros((2, 4000, 0)), DT_S)
    assert not np.isfinite(made[:, -1]).any()
    assert np.isfinite(made[:, 1]).all()


@pytest.mark.parametrize("fit", [fit_koopman, fit_gaussian_process])
def test_a_law_that_could_bend_follows_a_linear_motion_as_well(
    fit: Callable[[EvaluationSeries], Integrate],
) -> None:
    assert measure_error(fit, simulate, scale=1.0, start=1.0) < 0.06


@pytest.mark.parametrize("fit", [fit_koopman, fit_gaussian_process])
def test_a_law_that_can_bend_forecasts_a_pendulum_better(
    fit: Callable[[EvaluationSeries], Integrate],
) -> None:
    linear, bent = (measure_error(law, swing_pendulum, scale=3.0, start=1.0) for law in (fit_linear_law, fit))
    assert bent < 0.6 * linear


def test_a_training_part_without_a_clip_long_enough_is_refused() -> None:
    q = np.zeros((6, 1))
    with pytest.raises(ValueError, match="no training clip has 4 frames; use a longer recording"):
        fit_linear_law(train_on(q, np.zeros((6, 0)), ((0, 3), (3, 6))))
