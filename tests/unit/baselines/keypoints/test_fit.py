"""Training a key-point forecaster: it learns, it resumes, it says what is wrong."""

from dataclasses import replace

import numpy as np
import pytest
import torch

import lagsplat.baselines.keypoints.fit as fit
from lagsplat.baselines.keypoints.fit import choose_moment, fit_forecaster
from lagsplat.baselines.keypoints.model import continue_path, draw_path, fit_path
from tests.unit.baselines.keypoints.problems import STEPS, frames, settings


def error_of(images: np.ndarray, truth: np.ndarray) -> float:
    return float(np.square(images - np.moveaxis(truth, 3, 1) / 255.0).mean())


def test_pictures_and_key_points_follow_the_motion() -> None:
    film = frames()
    longer = {"warm_up": 60, "free": 250, "keys": 120, "joint": 200, "graph": 150}
    quick = {"motion": [1e-2, 1e-3], "place": [1e-2, 1e-3]}
    motion = {"hidden": 32, "place_noise": 0.02}
    config = settings(steps=longer, rate=quick, motion=motion, spatial_sigma=0.1)
    forecaster, curve = fit_forecaster(film, config, seed=0)
    at = np.arange(24.0)
    drawn = draw_path(forecaster, fit_path(forecaster, at), at)
    mean = np.repeat(film.mean(axis=0, keepdims=True), 24, axis=0)
    assert error_of(drawn, film) < 0.5 * error_of(np.moveaxis(mean, 3, 1) / 255.0, film)
    assert [point.phase for point in curve][-1] == "graph"
    graph = [point.error for point in curve if point.phase == "graph"]
    assert np.mean(graph[-5:]) < 0.5 * np.mean(graph[:5])
    ahead = continue_path(forecaster, 30)
    assert np.isfinite(ahead.places).all()


def test_a_clip_that_stands_still_stays_so() -> None:
    forecaster, _ = fit_forecaster(frames(moving=False), settings(), seed=0)
    path = fit_path(forecaster, np.arange(24.0))
    assert np.abs(np.diff(path.places, axis=0)).max() < 0.02


def test_the_phases_follow_one_another() -> None:
    config = settings()
    assert choose_moment(config, 0).phase == "warm_up"
    assert choose_moment(config, 10) == ("free", 0, 40)
    assert choose_moment(config, config.n_steps - 1) == ("graph", 59, 60)
    with pytest.raises(ValueError, match="past the end"):
        choose_moment(config, config.n_steps)


@pytest.mark.parametrize("stop", [35, 75, 95, 140])
def test_a_killed_training_ends_with_the_same_bits(tmp_path, monkeypatch, stop: int) -> None:
    config = replace(settings(), checkpoint_every_s=0.0)
    whole, curve = fit_forecaster(frames(), config, seed=3)

    class Killed(Exception):
        pass

    def until(fitting, step, real=fit.ForecasterFit.take_step):
        if step == stop:
            raise Killed
        return real(fitting, step)

    path = tmp_path / "state.pt"
    with monkeypatch.context() as patch:
        patch.setattr(fit.ForecasterFit, "take_step", until)
        with pytest.raises(Killed):
            fit_forecaster(frames(), config, seed=3, checkpoint=path, identity="a")
    again, resumed = fit_forecaster(frames(), config, seed=3, checkpoint=path, identity="a")
    for name, value in whole.state_dict().items():
        assert torch.equal(again.state_dict()[name], value), name
    assert [point[:4] for point in resumed] == [point[:4] for point in curve]


def test_what_cannot_be_trained_says_why() -> None:
    with pytest.raises(ValueError, match="forecast from 6 frames"):
        fit_forecaster(frames(6), settings(), seed=0)
    with pytest.raises(ValueError, match="key_points=80"):
        settings(motion={"key_points": 80})
    with pytest.raises(ValueError, match="neighbours"):
        settings(motion={"neighbours": 9})
    with pytest.raises(ValueError, match=r"forecaster\.steps"):
        settings(steps=STEPS | {"free": 0})
    with pytest.raises(ValueError, match="noise_until"):
        settings(graph={"noise_until": 0.0})


def test_a_loss_that_is_not_finite_stops_the_training(monkeypatch) -> None:
    nothing = torch.tensor(float("nan"), requires_grad=True)
    monkeypatch.setattr(fit.ForecasterFit, "image_loss", lambda *_: (nothing * 1.0, nothing.detach()))
    with pytest.raises(FloatingPointError, match="diverged at step 0"):
        fit_forecaster(frames(), settings(), seed=0)
