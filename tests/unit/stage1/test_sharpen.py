"""A finer decoder: it draws what the first one could not have seen, and leaves the latents alone."""

import numpy as np
import pytest
import torch

from lagsplat.stage1.autoencoder import decode_latents, encode_frames
from lagsplat.stage1.config import RenderConfig
from lagsplat.stage1.fit import fit_autoencoder, fit_decoder
from tests.unit.stage1.problems import small_config

RENDER = RenderConfig(factor=3.0, n_gaussians=120, steps=400, batch=8)


def fine_film(n: int) -> np.ndarray:
    """A hard-edged bar, (n, 36, 48, 3), whose edges fall between the pixels of a coarser camera."""
    rows, columns = np.indices((36, 48)) + 0.5
    place = 24 + 12 * np.sin(np.arange(n) / 3)
    bar = (np.abs(columns - place[:, None, None]) < 4) & (np.abs(rows - 18) < 12)
    image = 0.2 + 0.7 * bar[..., None] * np.array([0.9, 0.5, 0.2])
    return np.round(255 * image).astype(np.uint8)


def coarse(frames: np.ndarray) -> np.ndarray:
    """The same film through a camera with a third of the resolution."""
    blocks = frames.reshape(len(frames), 12, 3, 16, 3, 3).mean(axis=(2, 4))
    return np.round(blocks).astype(np.uint8)


def error(decoder, z, frames) -> float:
    drawn = decode_latents(decoder, z, height=36, width=48)
    return float(np.mean((drawn - np.moveaxis(frames, 3, 1) / 255.0) ** 2))


def test_the_finer_decoder_beats_the_first_one_at_its_resolution():
    frames = fine_film(60)
    first, _ = fit_autoencoder(coarse(frames), small_config(steps=200), seed=0)
    z = encode_frames(first, coarse(frames))
    before = [value.clone() for value in first.state_dict().values()]
    sharp, curve = fit_decoder(frames, z, small_config(), RENDER, seed=0)
    assert (sharp.height, sharp.width, sharp.gaussians.n) == (36, 48, 120)
    assert curve[-1].step == 400
    assert error(sharp, z, frames) < 0.5 * error(first, z, frames)
    assert all(torch.equal(a, b) for a, b in zip(before, first.state_dict().values(), strict=True))


def test_the_encoder_is_not_trained():
    frames, z = fine_film(20), np.sin(np.arange(20) / 3)[:, None]
    fresh, _ = fit_decoder(frames, z, small_config(), RenderConfig(3.0, 10, 1, 4), seed=0)
    longer, _ = fit_decoder(frames, z, small_config(), RenderConfig(3.0, 10, 30, 4), seed=0)
    for a, b in zip(fresh.encoder.parameters(), longer.encoder.parameters(), strict=True):
        assert torch.equal(a, b)


def test_each_frame_needs_its_latent():
    with pytest.raises(ValueError, match="20 frames and 19 latents"):
        fit_decoder(fine_film(20), np.zeros((19, 1)), small_config(), RENDER, seed=0)


@pytest.mark.parametrize("changes", [{"factor": 1.0}, {"steps": 0}])
def test_what_is_no_refinement_is_refused(changes):
    with pytest.raises(ValueError, match="render"):
        RenderConfig(**{"factor": 2.0, "n_gaussians": 1, "steps": 1, "batch": 1, **changes})


def test_the_finer_frames_have_the_same_shape():
    assert RenderConfig(2.5, 1, 1, 1).fine_size(92, 64) == (230, 160)
