"""What is measured past the training window, on a swing whose law is known."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.linalg import expm

from lagsplat.baselines.keypoints.model import Forecaster, place_key_point_scene, read_forecaster_architecture
from lagsplat.baselines.neural_ode import NeuralOde
from lagsplat.evaluate.extrapolation.forecast import (
    choose_looks,
    extrapolate_ode,
    extrapolate_run,
    extrapolate_trivially,
    fit_start,
    make_law_predictor,
    score_aligned_psnr,
    score_extrapolation,
    score_held_out_psnr,
    to_decibels,
)
from lagsplat.evaluate.extrapolation.images import (
    extrapolate_forecaster,
    extrapolate_frames,
    make_image_predictor,
)
from lagsplat.evaluate.extrapolation.oscillation import (
    compare_oscillations,
    fit_oscillation,
    measure_amplitude,
)
from lagsplat.evaluate.extrapolation.scene import Scene, choose_boundary_clip, open_scene, summarize_readings
from lagsplat.planning.plan import TRIVIAL
from lagsplat.stage2.numpy_lagrangian import NumpyLagrangian, roll_out_free
from tests.unit.baselines.keypoints import problems as key_points
from tests.unit.evaluate import swing

EYE = np.eye(1)


@pytest.fixture(scope="module")
def film():
    return swing.recording()


@pytest.fixture(scope="module")
def scene(film) -> Scene:
    return open_scene(*swing.run(film), film, swing.settings())


def test_an_oscillation_is_read_with_its_uncertainty() -> None:
    series = swing.motion(133)[:, None] + 0.01 * np.random.default_rng(0).normal(size=(133, 1))
    found = fit_oscillation(series, dt_s=swing.DT_S, metric=EYE)
    assert found is not None
    assert abs(found["frequency_hz"] - swing.FREQUENCY_HZ) < 4 * found["frequency_sigma"] < 0.05
    assert abs(found["rate_per_s"] - swing.RATE_PER_S) < 4 * found["rate_sigma"] < 0.2
    assert measure_amplitude(swing.motion(100)[:, None], EYE) == pytest.approx(0.94, abs=0.03)


def test_a_frequency_that_drifts_as_the_motion_dies_leaves_its_decay_alone() -> None:
    time_s = swing.DT_S * np.arange(133)
    phase = 2 * np.pi * (2.0 * time_s + 0.03 * time_s**2)
    series = np.exp(-0.25 * time_s) * np.cos(phase)
    series = series + 0.02 * np.random.default_rng(1).normal(size=133) + 0.05 * series**2
    found = fit_oscillation(series[:, None], dt_s=swing.DT_S, metric=EYE)
    assert found is not None
    assert found["rate_per_s"] == pytest.approx(0.25, abs=0.03)
    assert found["frequency_hz"] == pytest.approx(2.0 + 0.03 * time_s[-1], abs=0.01)
    noise = np.random.default_rng(2).normal(size=(133, 1))
    assert fit_oscillation(noise, dt_s=swing.DT_S, metric=EYE) is None


def test_errors_keep_their_sign_and_nothing_is_made_up() -> None:
    one = {"frequency_hz": 2.0, "frequency_sigma": 0.01, "rate_per_s": 0.5, "rate_sigma": 0.05}
    other = one | {"frequency_hz": 1.9, "rate_per_s": 0.2}
    found = compare_oscillations(one, other)
    assert (found["frequency_error"], found["rate_error"]) == pytest.approx((-0.05, -0.6))
    assert found["rate_error_sigma"] == pytest.approx(np.hypot(0.05, 0.02) / 0.5)
    assert compare_oscillations(one, None)["rate_error"] is None
    assert "predicted" in compare_oscillations(one, None)["reason"]
    assert fit_oscillation(np.zeros((50, 1)), dt_s=0.1, metric=EYE) is None
    assert fit_oscillation(np.full((50, 1), np.nan), dt_s=0.1, metric=EYE) is None


def test_a_lag_costs_decibels_until_it_is_taken_out() -> None:
    truth, ahead = swing.pictures(swing.motion(40)), np.arange(40.0)

    def late(at: np.ndarray) -> np.ndarray:
        time_s = swing.DT_S * (at - 1.0)
        swung = np.exp(-swing.RATE_PER_S * time_s) * np.cos(2 * np.pi * swing.FREQUENCY_HZ * time_s)
        return swing.pictures(swung)

    plain = score_held_out_psnr(late, truth, ahead)
    aligned = score_aligned_psnr(late, truth, ahead, shifts=np.linspace(-2, 2, 9))
    assert plain["mean"] < 35
    assert aligned["mean"] > 60
    assert np.median(aligned["shift"]) == 1.0
    assert plain["first"] == plain["per_frame"][0]
    np.testing.assert_allclose(to_decibels(np.array([0.01, 0.0])), [20.0, 100.0])


def test_the_clip_that_crosses_is_found_or_the_reason_given(scene) -> None:
    chart, crossing = scene.chart, scene.clip
    assert (crossing.n_train, crossing.stop) == (80, 120)
    assert crossing.period_s == pytest.approx(1 / swing.FREQUENCY_HZ, rel=0.03)
    np.testing.assert_allclose(crossing.ahead, np.arange(1.0, 41.0), atol=1e-9)
    with pytest.raises(ValueError, match="held_out_frames"):
        choose_boundary_clip(replace(chart, segments=((0, 80), (80, 120))))
    with pytest.raises(ValueError, match="driven"):
        choose_boundary_clip(replace(chart, inputs=np.arange(120.0)[:, None]))
    with pytest.raises(ValueError, match="no oscillation"):
        choose_boundary_clip(replace(chart, latents=np.zeros((120, 1))))


def linear_law(q0: np.ndarray, v0: np.ndarray, states: int) -> np.ndarray:
    omega, rate = 2 * np.pi * swing.FREQUENCY_HZ, swing.RATE_PER_S
    step = expm(np.array([[0.0, 1.0], [-(omega**2) - rate**2, -2 * rate]]) * swing.DT_S)
    path = [np.concatenate([q0, v0], axis=1)]
    for _ in range(states - 1):
        path.append(path[-1] @ step.T)
    return np.stack(path, axis=1)[:, :, :1]


def test_a_start_is_found_from_training_frames_alone(scene) -> None:
    path = linear_law(np.array([[1.0]]), np.array([[3.0]]), 120)[0]
    crossing = replace(scene.clip, latents=path)
    crossing.latents[80:] = np.nan
    q, v = fit_start(linear_law, crossing, at=0, frames=15)
    np.testing.assert_allclose([q[0, 0], v[0, 0]], [1.0, 3.0], rtol=1e-5)
    q, v = fit_start(linear_law, crossing, at=65, frames=15)
    assert np.isfinite([q, v]).all()


def test_frames_of_another_kind_are_out_of_range(scene) -> None:
    reading = scene.read(scene.pictures(np.arange(30)))
    np.testing.assert_allclose(reading.states, scene.chart.latents[:30], atol=1e-5)
    assert summarize_readings([reading])["inside"] == 1.0
    assert reading.distance.max() < 1e-5
    noise = np.random.default_rng(0).random((5, 3, swing.SIDE, swing.SIDE)).astype(np.float32)
    assert not scene.read(noise).inside.any()
    with pytest.raises(ValueError, match="20 x 16 pixels"):
        scene.read(np.zeros((2, 3, 20, 16), dtype=np.float32))


def test_a_run_is_measured_whole(scene) -> None:
    found = extrapolate_run(scene)
    assert found["recording"]["held_out"] == len(found["psnr"]["per_frame"]) == 40
    assert abs(found["psnr"]["mean"] - found["floor"]["mean"]) < 1.0
    assert found["aligned"]["mean"] >= found["psnr"]["mean"]
    assert abs(found["physics"]["frequency_error"]) < 0.03
    assert abs(found["physics"]["rate_error"]) < 0.4
    assert 0.0 <= found["left"] < 0.01
    assert found["looks"][-1]["first"] + len(found["looks"][-1]["states"]) == 600
    energies = [np.mean(look["energy"]) for look in found["looks"]]
    assert energies[-1] < 1e-3 * energies[0]
    assert found["guarantee"]["holds"]
    assert found["range"]["inside"] == 1.0


def test_a_model_that_is_never_in_range_gets_no_physics(scene) -> None:
    rng = np.random.default_rng(0)

    def noise(at: np.ndarray) -> np.ndarray:
        return rng.random((len(at), 3, swing.SIDE, swing.SIDE)).astype(np.float32)

    fitted = scene.pictures(np.arange(scene.clip.n_train))
    predictor = make_image_predictor(scene, fitted, noise, between_frames=False)
    found = score_extrapolation(predictor, scene)
    assert found["left"] is None
    assert found["physics"]["frequency_error"] is None
    assert "of the kind the encoder knows" in found["reason"]
    assert found["psnr"]["mean"] < 10


def test_pictures_of_the_truth_are_as_good_as_the_film(scene) -> None:
    def truth(at: np.ndarray) -> np.ndarray:
        return np.concatenate([swing.pictures(swing.motion(1, first=79 + int(t))) for t in at])

    fitted = scene.pictures(np.arange(scene.clip.n_train))
    predictor = make_image_predictor(scene, fitted, truth, between_frames=False)
    found = score_extrapolation(predictor, scene)
    assert found["psnr"]["mean"] > 45
    assert abs(found["physics"]["rate_error"]) < 0.02
    assert abs(found["held_out"]["frequency_error"]) < 0.02
    assert found["left"] < 0.01


def test_a_forecaster_and_a_free_equation_are_measured_alike(scene, film) -> None:
    torch.manual_seed(0)
    settings = key_points.settings()
    of = read_forecaster_architecture(settings, height=swing.SIDE, width=swing.SIDE, frames=80)
    forecaster = Forecaster(of, backend="torch")
    place_key_point_scene(
        forecaster.scene, film.frames[:80], sigma=0.1, opacity=0.5, rng=np.random.default_rng(0)
    )
    forecaster.keys.gather(forecaster.scene.place.detach(), forecaster.scene.feature.detach(), seed=0)
    pictures = extrapolate_forecaster(scene, forecaster.eval())
    ode = NeuralOde(1, 0, hidden=8, layers=1, method="rk4", time_unit_s=0.1)
    with torch.no_grad():
        ode.network[-1].weight.zero_()
        ode.network[-1].bias.zero_()
    still = extrapolate_ode(scene, ode)
    assert set(still) < set(pictures)
    assert pictures["own"]["fitted_psnr"] > 0
    assert len(pictures["own"]["in_time"]["per_frame"]) == 40
    # nothing moves where nothing changes: no amplitude, hence no oscillation
    assert still["left"] == 0.0
    assert still["physics"]["frequency_error"] is None
    longer, chart = swing.recording(held_out=30), replace(scene.chart, n_train=90)
    other = open_scene(scene.autoencoder, chart, scene.lagrangian, longer, scene.config)
    with pytest.raises(ValueError, match="trained on 80 frames of 16 x 16, the clip has 90"):
        extrapolate_forecaster(other, forecaster)


def test_laws_without_training_are_measured_alike(scene) -> None:
    found = extrapolate_trivially(scene)
    assert set(found) == set(TRIVIAL)
    still = max(found[name]["psnr"]["mean"] for name in ("mean", "hold"))
    assert found["linear"]["psnr"]["mean"] > 3.0 + still
    assert abs(found["linear"]["physics"]["frequency_error"]) < 0.03  # the swing is linear
    for name in ("mean", "hold"):
        assert found[name]["left"] == 0.0
        assert found[name]["physics"]["frequency_error"] is None


def test_frames_of_another_program_are_read_and_what_they_do_not_hold_is_not_said(scene) -> None:
    truth = np.moveaxis(swing.pictures(swing.motion(200, first=80)), 1, 3)
    frames = np.round(255 * truth).astype(np.uint8)
    found = extrapolate_frames(scene, frames)
    assert found["psnr"]["mean"] > 45
    assert found["left"] is None
    assert "were predicted, not the 20 s" in found["reason"]
    assert found["physics"]["frequency_error"] is None
    assert abs(found["held_out"]["frequency_error"]) < 0.01
    with pytest.raises(ValueError, match="20 predicted frames, but 40"):
        extrapolate_frames(scene, frames[:20])
    with pytest.raises(ValueError, match="8 x 16 pixels"):
        extrapolate_frames(scene, frames[:, :8])


def test_looks_end_at_the_horizon_and_never_overlap_what_is_shown(scene) -> None:
    looks = choose_looks(scene.clip, scene.config)
    assert looks[0] == (0, 120)
    assert looks[-1][1] == 600
    assert all(first >= 120 for first, _ in looks[1:])


def test_a_law_that_blows_up_is_measured_and_not_dropped(scene) -> None:
    def runaway(q0: np.ndarray, v0: np.ndarray, states: int) -> np.ndarray:
        with np.errstate(over="ignore"):
            return q0[:, None] * np.exp(8.0 * np.arange(states))[None, :, None]

    found = score_extrapolation(make_law_predictor(scene, runaway), scene)
    assert found["left"] is None
    assert found["psnr"]["mean"] < found["floor"]["mean"]
    law = NumpyLagrangian(scene.lagrangian)
    q, _ = roll_out_free(law, np.zeros((1, 1)), np.ones((1, 1)), states=5, dt_s=swing.DT_S)
    assert len(q[0]) == 5
