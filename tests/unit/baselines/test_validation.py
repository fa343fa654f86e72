"""Weights chosen by forecasts of a part that is kept from training."""

import numpy as np
import pytest
import torch

from lagsplat.baselines.fit import BaselineFit, fit_baseline
from lagsplat.baselines.validation import ForecastValidation
from lagsplat.stage1.autoencoder import to_images
from tests.unit.baselines.problems import DT_S, pushed_square, settings


@pytest.fixture(scope="module")
def train():
    return pushed_square().split()[0]  # 120 frames


def test_no_withheld_frame_is_trained_on(train) -> None:
    fit = BaselineFit(train, settings("osc_deconv", **{"validation.share": 0.4}), 0)
    assert fit.starts.max() + fit.config.batch <= 72 <= fit.validation.starts.min() - 1
    assert fit.validation.starts.max() + fit.validation.n_ahead == 119


def test_the_error_is_that_of_forecasts_of_half_a_second(train) -> None:
    config = settings("koopman_deconv", **{"validation.share": 0.4, "validation.starts": 3})
    fit = BaselineFit(train, config, 0)
    baseline, errors = fit.baseline, []
    assert fit.validation.n_ahead == 30
    images = to_images(fit.frames)
    with torch.no_grad():
        for start in fit.validation.starts.tolist():
            rate = (images[start + 1] - images[start - 1]) / (2 * DT_S)
            z, _, v = baseline.encoder.moving(images[start, None], rate[None])
            for ahead in range(1, 31):
                z, v = baseline.dynamics(z, v, fit.inputs[start + ahead - 1, None])
                errors.append(float((baseline.decode(z)[0] - images[start + ahead]).square().mean()))
    assert fit.validation.measure_error(baseline) == pytest.approx(np.mean(errors), rel=1e-5)


def test_the_weights_of_the_best_check_are_kept(train, monkeypatch) -> None:
    errors, seen = iter([3.0, 1.0, np.inf, 2.0]), []

    def measure(_, baseline) -> float:
        seen.append({name: value.clone() for name, value in baseline.state_dict().items()})
        return next(errors)

    monkeypatch.setattr(ForecastValidation, "measure_error", measure)
    changes = {"validation.share": 0.4, "validation.checks": 4, "steps.deconv": 8}
    kept, curve = fit_baseline(train, settings("osc_deconv", **changes), seed=0)
    assert all(torch.equal(value, seen[1][name]) for name, value in kept.state_dict().items())
    assert [point.validation for point in curve if point.step % 2 == 0] == [3.0, 1.0, np.inf, 2.0]


def test_a_forecast_that_is_not_finite_is_never_chosen(train) -> None:
    fit = BaselineFit(train, settings("osc_deconv", **{"validation.share": 0.4}), 0)
    with torch.no_grad():
        fit.baseline.encoder.head.bias.fill_(float("nan"))
    fit.validate(fit.config.n_steps)
    assert float(fit.selection.error) == float(fit.selection.least) == np.inf
    assert all(value.isfinite().all() for value in fit.selection.best.parameters())


def test_a_part_too_short_for_a_forecast_is_refused(train) -> None:
    with pytest.raises(ValueError, match=r"have no clip of 32 frames.*baseline\.validation\.share"):
        BaselineFit(train, settings("osc_deconv", **{"validation.share": 0.1}), 0)
