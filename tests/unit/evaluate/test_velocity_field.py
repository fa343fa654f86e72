"""Velocities of primitives: what is smooth, what is rough, and what moves on the background."""

import numpy as np
import pytest
import torch

from lagsplat.evaluate.velocity_field import (
    FastestMoment,
    compute_velocity_field,
    estimate_background,
    find_fastest_moment,
    load_maps,
    save_maps,
)
from lagsplat.stage1.planar_decoder import CONDITIONED, PlanarDecoder, start_planar_decoder
from tests.unit.evaluate import swing
from tests.unit.stage1.problems import small_config, swinging_bar
from tests.unit.stage1.test_planar_decoder import LATENTS, settings

FRAMES = swinging_bar(40)
MOMENT = FastestMoment(3, np.array([0.1]), np.array([2.0]))


def carried(shift: float) -> PlanarDecoder:
    """A decoder all of whose primitives follow the latent alike, [px per unit]."""
    decoder = start_planar_decoder(CONDITIONED, FRAMES, LATENTS, settings(), small_config(), seed=0)
    with torch.no_grad():
        decoder.gaussians.precision_log_diagonal.fill_(-3.0)
        decoder.gaussians.coupling.zero_()
        decoder.gaussians.coupling[:, 0] = shift * np.exp(3.0)
    return decoder.eval()


def measured(decoder: PlanarDecoder):
    return compute_velocity_field(decoder, FRAMES, LATENTS, MOMENT, window=7, neighbours=3, backend="numba")


def test_a_common_motion_is_smooth_and_as_fast_as_it_is() -> None:
    found, maps = measured(carried(1.5))
    assert found["roughness"] == pytest.approx(0.0, abs=1e-5)
    assert found["speed"] == pytest.approx(3.0, rel=1e-4)
    assert found["painted_still"] > 0.1  # all primitives move, those of the background too
    assert maps["picture"].shape == (3, 12, 16)
    assert maps["speed"].max() <= 3.0 + 1e-4


def test_primitives_that_move_each_for_itself_are_rough() -> None:
    decoder = carried(0.0)
    with torch.no_grad():
        decoder.gaussians.coupling.normal_(std=np.exp(3.0))
    found, _ = measured(decoder)
    assert found["roughness"] > 1.0
    quiet, _ = measured(carried(0.0))
    assert quiet["roughness"] == quiet["painted_still"] == 0.0


def test_a_decoder_that_draws_nothing_has_no_roughness() -> None:
    decoder = carried(1.0)
    with torch.no_grad():
        decoder.gaussians.opacity_logit.fill_(-20.0)
    found, _ = measured(decoder)
    assert found["roughness"] is None
    assert found["speed"] is None
    assert found["visible"] == 0


def test_the_background_is_what_never_changes() -> None:
    frames = np.full((20, 6, 8, 3), 90, dtype=np.uint8)
    frames[:, 2:4, 2:6] = np.arange(0, 200, 10, dtype=np.uint8)[:, None, None, None]
    noisy = frames + np.random.default_rng(0).integers(0, 3, frames.shape, dtype=np.uint8)
    still = estimate_background(noisy)
    assert not still[2:4, 2:6].any()
    assert still.mean() > 0.5


def test_the_fastest_moment_is_a_passage_through_the_middle() -> None:
    film = swing.recording()
    _, chart, _ = swing.run(film)
    moment = find_fastest_moment(chart)
    assert moment.frame < 20
    assert abs(swing.motion(120)[moment.frame]) < 0.5


def test_maps_come_back_with_their_measures(tmp_path) -> None:
    found, maps = measured(carried(1.0))
    save_maps(tmp_path / "maps.safetensors", {CONDITIONED: maps}, {CONDITIONED: found}, {"seed": 0})
    again, measures = load_maps(tmp_path / "maps.safetensors")
    np.testing.assert_array_equal(again[CONDITIONED]["speed"], maps["speed"])
    assert measures[CONDITIONED]["frame"] == 3
