"""The autoencoder floor."""

import numpy as np
import pytest

from lagsplat.evaluate.forecast import image_errors, measure_autoencoder_floor
from tests.unit.evaluate.stand_ins import subject, world


def test_floor_is_the_error_of_the_unsmoothed_latents_after_the_skip():
    held, pictures = world()
    offset = np.full((held.n_frames, 1, 1, 1), 0.01, dtype=np.float32)
    offset[: held.skip] = 9.0
    model = subject(held=held, pictures=lambda chosen: pictures(chosen) + offset[chosen])
    result = measure_autoencoder_floor(model, most=1000)
    assert result["value"] == pytest.approx(1e-4, rel=1e-4)
    assert result["frames"] == 1000
    assert measure_autoencoder_floor(subject(), most=10**6)["frames"] == held.n_frames - held.skip


def test_renders_are_clamped_and_resolutions_must_agree():
    white = np.ones((2, 3, 4, 4), dtype=np.float32)
    assert np.allclose(image_errors(white * 7, white), 0.0)
    with pytest.raises(ValueError, match="trained at another resolution"):
        image_errors(white[:, :, :3], white)
