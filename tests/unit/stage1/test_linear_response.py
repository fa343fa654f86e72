"""Latents of a driven motion are its linear response to the inputs."""

import numpy as np
import pytest
import torch
from scipy.signal import lfilter

from lagsplat.stage1.encoder import Encoder
from lagsplat.stage1.encoder_initialization import initialize_encoder
from lagsplat.stage1.gaussian_initialization import initialize_autoencoder
from lagsplat.stage1.linear_response import InputHistory, fit_linear_response
from lagsplat.stage1.objective import reconstruct
from lagsplat.stage1.training_data import TrainingFrames
from tests.unit.stage1.problems import small_config

T = 4000


def drive(n_inputs, *, seed=0):
    """Random inputs, band-limited to a tenth of the frame rate."""
    noise = np.random.default_rng(seed).standard_normal((T, n_inputs))
    return lfilter([0.2], [1.0, -0.8], noise, axis=0)


def respond(force):
    """An oscillation of 20 frames a period, which decays by a half in two periods."""
    r, turn = 0.983, 2 * np.pi / 20
    x = lfilter([1.0], [1.0, -2 * r * np.cos(turn), r * r], force)
    return x / x.std()


@pytest.fixture
def mechanism():
    """Two coordinates of unit size, and the inputs that drive them."""
    u = drive(2)
    fast = lfilter([1.0], [1.0, -0.6], u[:, 1])
    return np.stack([respond(u[:, 0]), fast / fast.std()], axis=1), u


def whole(u):
    return InputHistory(u, ((0, T),))


def explained(x, by):
    """Share of the variance of each column that a linear function explains."""
    columns = np.c_[np.ones(len(by)), by]
    left = x - columns @ np.linalg.lstsq(columns, x, rcond=None)[0]
    return 1.0 - left.var(axis=0) / x.var(axis=0)


def test_bent_coordinates_become_straight(mechanism):
    x, u = mechanism
    bent = x + [0.0, 0.5] * x[:, :1] ** 2
    features = np.stack([bent[:, 0], bent[:, 1], bent[:, 0] ** 2, bent[:, 0] * bent[:, 1]], axis=1)
    history = whole(u).before(np.arange(T))
    response = fit_linear_response(features, history, 2)
    found = (features - features.mean(axis=0)) @ response.weights
    left = found - response.predict(history)
    assert np.cov(found.T, ddof=0) == pytest.approx(np.eye(2), abs=1e-6)
    assert left.var(axis=0) == pytest.approx(response.variance, rel=1e-6)
    assert (explained(found, x) > 0.99).all()
    assert explained(bent, x)[1] < 0.8


@pytest.mark.parametrize("case", ["undriven", "one of two", "short", "too many"])
def test_no_response_is_told(mechanism, case):
    x, u = mechanism
    free = np.stack([respond(drive(1, seed=seed)[:, 0]) for seed in (5, 6)], axis=1)
    features = {"undriven": free, "one of two": np.c_[x[:, 0], free[:, 0]]}.get(case, x)
    n = 90 if case == "short" else T
    history = whole(u).before(np.arange(n))
    assert fit_linear_response(features[:n], history, 3 if case == "too many" else 2) is None


def test_features_that_hardly_vary_are_left_out(mechanism):
    x, u = mechanism
    features = np.c_[x + 0.1 * x**2, 1e-5 * x**2]
    response = fit_linear_response(features, whole(u).before(np.arange(T)), 2)
    assert np.abs(response.weights).max() < 10.0


def test_inputs_before_a_segment_are_its_first():
    u = np.arange(20.0)[:, None]
    history = InputHistory(u, ((0, 8), (8, 20)))
    before = history.before(np.array([0, 7, 8, 10, 19]))
    assert before[:, 0] == pytest.approx([0, 7, 8, 10, 19])
    assert before[:, -1] == pytest.approx([0, 0, 8, 8, 8])
    assert (np.diff(before, axis=1) <= 0).all()


def film(x):
    """A bright spot that moves along an arc by the first coordinate, and grows by the second."""
    rows, columns = np.mgrid[:20, :24] + 0.5
    angle = 0.35 * np.clip(x[:, 0], -3, 3)
    across, down = 12 + 9 * np.sin(angle), 3 + 12 * np.cos(angle)
    size = 4.0 * np.exp(0.3 * np.clip(x[:, 1], -3, 3))
    spots = [
        np.exp(-((columns - a) ** 2 + (rows - b) ** 2) / s)
        for a, b, s in zip(across, down, size, strict=True)
    ]
    return np.repeat(np.round(60 + 190 * np.stack(spots))[..., None], 3, axis=3).astype(np.uint8)


def test_an_encoder_starts_with_the_response(mechanism):
    x, u = mechanism
    footage = TrainingFrames(film(x), history=whole(u))
    torch.manual_seed(0)
    encoder = Encoder(2, kernel=6, channels=2)
    response = initialize_encoder(encoder, footage, seed=0)
    frames = np.arange(T)
    latents = encoder(footage.images(frames)).detach().double().numpy()
    assert (explained(latents, x) > 0.95).all()
    assert latents.std(axis=0) == pytest.approx(1.0, abs=0.02)
    expected = footage.expect(frames, response)
    left = (latents - expected.mean.double().numpy()).var(axis=0)
    assert left == pytest.approx(expected.variance.double().numpy(), rel=0.1)


def test_a_departure_costs_in_units_of_what_the_response_leaves_open(mechanism):
    x, u = mechanism
    footage, config = TrainingFrames(film(x), history=whole(u)), small_config(d=2, kernel=6)
    autoencoder, response = initialize_autoencoder(footage, config, seed=0)
    picked = np.arange(0, T, 400)
    expected = footage.expect(picked, response)

    def loss(expected):
        images = footage.images(picked)
        return reconstruct(autoencoder, images, config.loss, latents=None, expected=expected).loss

    autoencoder.encoder.requires_grad_(False)
    departure = autoencoder.encode(footage.images(picked)) - expected.mean
    cost = config.loss.linear_response * (departure**2 / expected.variance).mean()
    assert (loss(expected) - loss(None)).item() == pytest.approx(cost.item(), rel=1e-2)
    assert cost > 0.0


def test_undriven_latents_start_without_a_response(mechanism):
    _, u = mechanism
    free = np.stack([respond(drive(1, seed=seed)[:, 0]) for seed in (5, 6)], axis=1)[:400]
    footage = TrainingFrames(film(free), history=InputHistory(u[:400], ((0, 400),)))
    encoder = Encoder(2, kernel=6, channels=2)
    assert initialize_encoder(encoder, footage, seed=0) is None
    assert footage.expect(np.arange(4), None) is None


def test_inputs_that_never_move_tell_nothing(mechanism):
    x, _ = mechanism
    for still in (np.ones((T, 2)), np.ones((T, 0))):
        assert fit_linear_response(x, whole(still).before(np.arange(T)), 2) is None
