import numpy as np
import pytest
import torch

from lagsplat.chart.chart import require_trained_autoencoder
from tests.unit.evaluate.tiny_run import autoencoder, recording


def test_an_autoencoder_that_nobody_trained_is_refused() -> None:
    with pytest.raises(ValueError, match=r"mean squared error of .* raise stage1\.steps"):
        require_trained_autoencoder(autoencoder(), recording().frames)


def test_the_share_left_unexplained_is_that_of_the_pictures_it_draws() -> None:
    model = autoencoder()
    with torch.no_grad():
        model.gaussians.opacity_logit.fill_(-20.0)
        model.gaussians.background_logit.zero_()  # it draws grey, whatever it sees
    brightness = np.array([0, 255], np.uint8).repeat(20)
    frames = np.broadcast_to(brightness[:, None, None, None], (40, 16, 16, 3)).copy()
    with pytest.raises(ValueError, match=r"2\.50e-01, and their mean alone would err by 2\.50e-01"):
        require_trained_autoencoder(model, frames)
