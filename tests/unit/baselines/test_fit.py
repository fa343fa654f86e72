"""Training of the baselines: it learns, it is repeatable, and an interruption leaves no trace."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from lagsplat.baselines import fit as fit_module
from lagsplat.baselines.fit import (
    BaselineFit,
    closing_term_weight,
    fit_baseline,
    make_baseline_optimizer,
    set_rates,
)
from lagsplat.baselines.model import Baseline
from lagsplat.config.compose import ConfigError
from tests.unit.baselines.problems import architecture, pushed_square, settings

NAMES = ("osc_deconv", "osc_abcd", "koopman_deconv", "koopman_abcd")


def weights(baseline):
    return torch.cat([value.flatten() for value in baseline.state_dict().values()])


@pytest.fixture(scope="module")
def train():
    return pushed_square().split()[0]


def test_training_reduces_the_error_of_a_frame_and_of_the_next(train):
    config = settings("osc_deconv", **{"steps.deconv": 200})
    _, curve = fit_baseline(train, config, seed=0)
    assert curve[-1].reconstruction < 0.3 * curve[0].reconstruction
    assert curve[-1].ahead < 0.3 * curve[0].ahead
    assert curve[-1].step == 200


@pytest.mark.parametrize("name", NAMES)
def test_every_choice_trains_and_reports_the_terms_it_has(train, name):
    few = {"steps.deconv": 4, "steps.abcd": 4, "validation.share": 0.4, "validation.checks": 4}
    _, curve = fit_baseline(train, settings(name, **few), seed=0)
    most = fit_module.BaselineCurvePoint._make(np.max(curve, axis=0))
    assert np.isfinite(most).all()
    assert (most.steady > 0) == name.startswith("osc")
    assert (most.attention > 0) == name.endswith("abcd")
    assert (most.closing > 0) == (name == "osc_abcd")


def test_same_seed_same_bits_other_seed_other_bits(train):
    config = settings("osc_abcd", **{"steps.abcd": 4})
    runs = [fit_baseline(train, config, seed=seed)[0] for seed in (3, 3, 4)]
    assert torch.equal(weights(runs[0]), weights(runs[1]))
    assert not torch.equal(weights(runs[0]), weights(runs[2]))


@pytest.mark.parametrize("share", [0.0, 0.4])
def test_a_killed_run_goes_on_to_the_same_bits(train, tmp_path, monkeypatch, share):
    config = settings("koopman_deconv", **{"validation.share": share, "validation.checks": 8})
    whole, whole_curve = fit_baseline(train, config, seed=1)
    step_of = BaselineFit.train_step

    def killed_at_17(fit, step):
        if step == 17:
            raise KeyboardInterrupt
        return step_of(fit, step)

    checkpoint = tmp_path / "state.pt"
    with monkeypatch.context() as patch:
        patch.setattr(BaselineFit, "train_step", killed_at_17)
        with pytest.raises(KeyboardInterrupt):
            fit_baseline(train, config, seed=1, checkpoint=checkpoint, identity="a")
    resumed, curve = fit_baseline(train, config, seed=1, checkpoint=checkpoint, identity="a")
    assert torch.equal(weights(whole), weights(resumed))
    np.testing.assert_array_equal([point[:-1] for point in curve], [point[:-1] for point in whole_curve])
    fresh, _ = fit_baseline(train, config, seed=1, checkpoint=checkpoint, identity="b")
    assert torch.equal(weights(whole), weights(fresh))


def overflowing_in(steps, monkeypatch):
    """Training whose encoder claims a variance beyond single precision in these steps."""
    step_of = BaselineFit.train_step

    def stumbling(fit, step):
        bias = fit.baseline.encoder.head.bias
        kept = bias.detach().clone()
        with torch.no_grad():
            bias += 1e3 * (step in steps)
        terms = step_of(fit, step)
        if terms is None:
            with torch.no_grad():
                bias.copy_(kept)
        return terms

    monkeypatch.setattr(BaselineFit, "train_step", stumbling)


def test_a_batch_without_a_finite_gradient_teaches_nothing(train, monkeypatch, caplog):
    overflowing_in({5, 6}, monkeypatch)
    baseline, curve = fit_baseline(train, settings("koopman_deconv"), seed=1)
    assert torch.isfinite(weights(baseline)).all()
    assert np.isnan(curve[5].loss)
    assert np.isfinite(curve[-1].loss)
    assert [record.args for record in caplog.records] == [(5,), (6,)]


def test_ten_of_them_in_a_row_end_the_training(train, monkeypatch):
    overflowing_in(range(3, 99), monkeypatch)
    with pytest.raises(FloatingPointError, match="before step 12: 10 batches in a row"):
        fit_baseline(train, settings("koopman_deconv"), seed=1)


def test_rates_climb_in_stairs_and_drop_once():
    config = settings("osc_abcd").rate
    baseline = Baseline(architecture())
    optimizer = make_baseline_optimizer(baseline, config)

    def rates(epoch):
        set_rates(optimizer, config, step=epoch, steps=300)
        return {group["part"]: group["lr"] / config.peak for group in optimizer.param_groups}

    encoder = [rates(epoch)["encoder"] for epoch in range(6)]
    assert encoder == pytest.approx([0.1, 0.28, 0.46, 0.64, 0.82, 1.0])
    assert rates(0)["decoder"] == 1.0
    assert [rates(epoch)["dynamics"] for epoch in (204, 205, 299)] == pytest.approx([1.0, 0.3, 0.3])
    plain = settings("osc_deconv").rate
    set_rates(optimizer, plain, step=200, steps=300)
    assert optimizer.param_groups[0]["lr"] == pytest.approx(3e-4)
    loss = settings("osc_abcd").loss
    assert [closing_term_weight(loss, step=step, steps=300) for step in (4, 5)] == [0.01, 0.1]


def test_logarithms_do_not_decay():
    optimizer = make_baseline_optimizer(Baseline(architecture()), settings("osc_abcd").rate)
    kept = [group for group in optimizer.param_groups if group["weight_decay"] == 0]
    assert [len(group["params"]) for group in kept] == [4]


def test_batches_keep_to_clips_and_cover_a_pass(train):
    config = settings("osc_deconv", batch=16, order="sequential")
    cut = replace(train, segments=((0, 40), (40, 120)))
    footage = BaselineFit(cut, config, 0)
    assert footage.starts.tolist() == [0, 16, 40, 56, 72, 88, 104]
    order = [footage.choose_start(step) for step in range(8)]
    assert order == [*footage.starts.tolist(), 0]
    config.order = "shuffled"
    order = [footage.choose_start(step) for step in range(14)]
    assert sorted(order[:7]) == sorted(order[7:]) == footage.starts.tolist()
    assert order[:7] != order[7:]


def test_what_cannot_be_trained_is_refused(train):
    mute = replace(train, inputs=np.zeros((train.n_frames, 0)), input_names=(), input_units=())
    with pytest.raises(ValueError, match="no inputs"):
        fit_baseline(mute, settings("osc_deconv"), seed=0)
    with pytest.raises(ValueError, match=r"baseline\.batch"):
        fit_baseline(train, settings("osc_deconv", batch=200), seed=0)
    config = settings("osc_deconv")
    config.rate.peak = 1e30
    with pytest.raises(FloatingPointError, match=r"baseline\.rate\.peak"):
        fit_baseline(train, config, seed=0)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("d", 5, "must be even"),
        ("decoder", "gaussian", "none of deconv, abcd"),
        ("order", "random", "sequential"),
        ("steps.abcd", 0, "at least 1"),
        ("batch", 2, "three frames"),
        ("loss.closing", -1, "at least 0"),
        ("rate.warmup", 1.5, r"must lie in \[0, 1\)"),
    ],
)
def test_values_outside_their_domain_stop_planning(key, value, words):
    with pytest.raises(ConfigError, match=words):
        settings("osc_abcd", **{key: value})
