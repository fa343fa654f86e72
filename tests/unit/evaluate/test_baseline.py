"""The baselines under the common protocol: the same starts, their own code path for everything else."""

import numpy as np
import pytest
import torch

from lagsplat.baselines.fit import choose_architecture
from lagsplat.baselines.model import Baseline
from lagsplat.evaluate.baseline import (
    accelerate_baseline,
    compute_baseline_modes,
    describe_baseline_force_reach,
    estimate_velocities,
    evaluate_baseline,
    pull_back_force,
    read_held_out,
)
from lagsplat.evaluate.evaluate import evaluate, make_picture_reader
from lagsplat.evaluate.protocol import initial_states
from tests.unit.baselines.problems import architecture
from tests.unit.baselines.problems import settings as baseline_settings
from tests.unit.evaluate import tiny_run
from tests.unit.evaluate.stand_ins import settings

NAMES = ("osc_deconv", "osc_abcd", "koopman_deconv", "koopman_abcd")


@pytest.fixture(scope="module")
def film():
    return tiny_run.recording()


def untrained(name, film):
    torch.manual_seed(0)
    return Baseline(choose_architecture(baseline_settings(name), film)).eval()


@pytest.fixture(scope="module")
def metrics(film):
    protocol = settings(starts=6, floor_frames=40, period_s=0.5, velocity="forward")
    return {name: evaluate_baseline(untrained(name, film), film, protocol) for name in NAMES}


def test_all_models_start_at_the_same_frames(metrics, film):
    model = tiny_run.autoencoder()
    chart = tiny_run.chart(model, film)
    protocol = settings(starts=6, floor_frames=40, period_s=0.5, velocity="forward")
    ours = evaluate(model, chart, tiny_run.lagrangian(), film, protocol)
    for theirs in metrics.values():
        for block in ("forecast", "latent"):
            assert theirs[block]["starts"] == ours[block]["starts"]
            assert theirs[block]["states"] == ours[block]["states"]
        assert theirs["forecast"]["hold"] == ours["forecast"]["hold"]
        assert theirs.keys() == ours.keys() - {"inertia"}
        assert theirs["scores"].keys() == ours["scores"].keys()


def test_a_force_reaches_as_far_as_each_model_can_take_it(metrics):
    said = {name: scores["scores"]["external_force"] for name, scores in metrics.items()}
    assert said == {
        "osc_deconv": "latent only",
        "osc_abcd": "at 2 centres",
        "koopman_deconv": "none",
        "koopman_abcd": "none",
    }


def test_a_push_at_a_centre_moves_that_centre_its_way():
    torch.manual_seed(3)
    baseline = Baseline(architecture())
    z = torch.randn(2, 4)
    forces = torch.zeros(2, 2, 2)
    forces[:, 1, 0] = 1.0
    push = pull_back_force(baseline, z, forces)
    assert push is not None
    answer = accelerate_baseline(baseline, z, push)
    # The power of a force along the motion it causes is never negative.
    assert ((push * answer).sum(1) > 0).all()
    assert describe_baseline_force_reach(baseline, z) == "at 2 centres"


def test_the_score_of_the_states_ahead_leaves_out_the_given_one(metrics):
    forecast = metrics["koopman_deconv"]["forecast"]
    assert forecast["mse_ahead"] == pytest.approx(np.mean(forecast["per_window_ahead"]))
    assert forecast["mse_ahead"] != forecast["mse"]


def test_states_are_the_encoders_and_so_are_velocities(film):
    baseline, protocol = untrained("osc_abcd", film), settings(velocity="forward")
    pictures = make_picture_reader(film, first=film.n_train)
    held = read_held_out(baseline, film, pictures, protocol)
    frames = torch.from_numpy(pictures(np.array([5, 6, 7])))
    with torch.no_grad():
        mean, _, velocity = baseline.encoder.moving(frames[:1], (frames[1:2] - frames[:1]) / tiny_run.DT_S)
    q0, v0 = initial_states(held, np.array([5]))
    assert np.allclose(q0, mean, atol=1e-6)
    assert np.allclose(v0, velocity, rtol=1e-4, atol=1e-5)
    assert np.array_equal(held.forcing[0, :3], film.inputs[film.n_train - 3 : film.n_train, 0])
    assert np.array_equal(held.standing[7], np.repeat(film.inputs[film.n_train + 7], 4))
    between = estimate_velocities(baseline, pictures, film.split()[1], forward=False)
    with torch.no_grad():
        rates = (frames[2:] - frames[:1]) / (2 * tiny_run.DT_S)
        expected = baseline.encoder.moving(frames[1:2], rates)[2]
    assert np.allclose(between(np.array([6])), expected, rtol=1e-4, atol=1e-5)
    last = film.n_frames - film.n_train - 1
    assert np.isfinite(between(np.array([0, last]))).all()


def test_modes_are_those_of_the_one_step_map(film):
    baseline = untrained("koopman_deconv", film)
    angle, radius = 0.3, 0.98
    turn = radius * torch.tensor([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    with torch.no_grad():
        baseline.dynamics.matrix.copy_(torch.block_diag(*[turn.float()] * 4))
    for mode in compute_baseline_modes(baseline):
        assert mode["frequency_hz"] == pytest.approx(angle / (2 * np.pi * tiny_run.DT_S), rel=1e-4)
        assert mode["rate_per_s"] == pytest.approx(-np.log(radius) / tiny_run.DT_S, rel=1e-3)


def test_weights_of_another_system_are_refused(film):
    with pytest.raises(ValueError, match="weights are of this system"):
        evaluate_baseline(Baseline(architecture()), film, settings())
