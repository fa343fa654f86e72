"""The free differential equation: its rollouts, its training, its resumption."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from omegaconf import OmegaConf

import lagsplat.baselines.neural_ode as fit
from lagsplat.baselines.config import OdeConfig
from lagsplat.baselines.neural_ode import NeuralOde, continue_rollout, fit_ode, load_ode, save_ode
from lagsplat.chart.trajectory import EncodedTrajectory

CONF = Path(__file__).parents[3] / "conf" / "ode" / "default.yaml"
DT_S = 1 / 30


def settings(**changes: object) -> OdeConfig:
    small = {"hidden": 16, "steps": 40, "batch": 16}
    schema = OmegaConf.structured(OdeConfig)
    return OmegaConf.to_object(OmegaConf.merge(schema, OmegaConf.load(CONF), small, changes))


def swing(frames: int = 90, *, uneven: bool = False) -> EncodedTrajectory:
    time_s = DT_S * np.arange(frames)
    if uneven:
        time_s = time_s + 0.2 * DT_S * np.random.default_rng(0).uniform(size=frames)
    q = np.exp(-0.3 * time_s) * np.cos(2 * np.pi * 2.0 * time_s)
    return EncodedTrajectory(q[:, None], np.zeros((frames, 0)), time_s, ((0, frames),))


@pytest.mark.parametrize("method", ["rk4", "midpoint"])
def test_plain_arrays_go_where_torchdiffeq_goes(method: str) -> None:
    torch.manual_seed(0)
    ode = NeuralOde(2, hidden=8, layers=2, method=method, time_unit_s=0.1)
    q, v = np.random.default_rng(0).normal(size=(2, 3, 2))
    start = torch.from_numpy(np.concatenate([q, 0.1 * v], axis=1))
    with torch.no_grad():
        wanted = ode.rollout(start, states=30, dt_s=DT_S).numpy()[:, :, :2]
    found = continue_rollout(ode, q, v, states=30, dt_s=DT_S)
    np.testing.assert_allclose(found, np.moveaxis(wanted, 0, 1), rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("uneven", [False, True])
def test_it_learns_a_swing_over_its_windows(uneven: bool) -> None:
    train = swing(uneven=uneven)
    ode, curve = fit_ode(train, np.eye(1), settings(steps=250), seed=0)
    assert curve[-1].loss < 0.05 * curve[0].loss
    assert ode.time_unit_s == pytest.approx(1 / (2 * np.pi * 2.0), rel=0.1)
    start = np.array([[1.0]]), np.array([[-0.3]])
    path = continue_rollout(ode, *start, states=15, dt_s=DT_S)[0, :, 0]
    truth = np.exp(-0.3 * DT_S * np.arange(15)) * np.cos(4 * np.pi * DT_S * np.arange(15))
    assert np.abs(path - truth).max() < 0.25


def test_a_killed_training_ends_with_the_same_bits(tmp_path, monkeypatch) -> None:
    config = replace(settings(), checkpoint_every_s=0.0)
    whole, _ = fit_ode(swing(), np.eye(1), config, seed=1)

    class Killed(Exception):
        pass

    steps = iter(range(40))

    def until(*given, real=fit._windows):
        if next(steps) == 21:
            raise Killed
        return real(*given)

    path = tmp_path / "state.pt"
    with monkeypatch.context() as patch:
        patch.setattr(fit, "_windows", until)
        with pytest.raises(Killed):
            fit_ode(swing(), np.eye(1), config, seed=1, checkpoint=path, identity="a")
    again, curve = fit_ode(swing(), np.eye(1), config, seed=1, checkpoint=path, identity="a")
    assert curve[-1].step == 40
    for name, value in whole.state_dict().items():
        assert torch.equal(again.state_dict()[name], value), name


def test_it_comes_back_from_its_file(tmp_path) -> None:
    ode = NeuralOde(1, hidden=8, layers=1, method="rk4", time_unit_s=0.2)
    save_ode(tmp_path / "ode.safetensors", ode, {"wall_s": 2.0})
    again, header = load_ode(tmp_path / "ode.safetensors")
    assert header["wall_s"] == 2.0
    torch.testing.assert_close(
        again(torch.zeros(1), torch.ones(1, 2).double()).detach(),
        ode(torch.zeros(1), torch.ones(1, 2).double()).detach(),
    )


def test_what_cannot_be_fitted_says_why() -> None:
    with pytest.raises(ValueError, match="needs four"):
        fit_ode(swing(3), np.eye(1), settings(), seed=0)
    with pytest.raises(ValueError, match=r"ode\.method"):
        settings(method="euler")
    with pytest.raises(ValueError, match="final_fraction"):
        settings(final_fraction=0.0)
