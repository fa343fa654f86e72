"""Recycling keeps what is drawn where it should, and leaves no trace of a former life in Adam."""

import numpy as np
import pytest
import torch

from lagsplat.stage1.autoencoder import to_images
from lagsplat.stage1.config import LifecycleConfig
from lagsplat.stage1.densification import densify_and_prune, is_due, measure_peak_opacity, split_gaussians
from lagsplat.stage1.fit import fit_autoencoder
from lagsplat.stage1.objective import make_optimizer
from lagsplat.stage1.training_data import TrainingFrames
from tests.unit.splat.test_gaussians import full_covariance, random_gaussians
from tests.unit.stage1.problems import small_autoencoder, small_config, swinging_bar


def test_a_split_pair_has_the_mean_and_covariance_of_its_parent():
    gaussians = random_gaussians(6, 3).float()
    parent = gaussians.double()
    before = full_covariance(parent).detach()[0]
    middle = torch.cat((parent.latent_center, parent.center), 1).detach()[0].clone()
    opacity = parent.opacity_logit.sigmoid()[0].item()
    with torch.no_grad():
        split_gaussians(parent, torch.tensor([0]), torch.tensor([4]))
    after = full_covariance(parent).detach()
    centers = torch.cat((parent.latent_center, parent.center), 1).detach()
    offset = centers[0] - middle
    torch.testing.assert_close((centers[0] + centers[4]) / 2, middle, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(after[0] + offset[:, None] * offset[None], before, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(after[0], after[4])
    pair = parent.opacity_logit.sigmoid()[[0, 4]].detach()
    assert 1 - (1 - pair[0]) * (1 - pair[1]) == pytest.approx(opacity, abs=1e-5)


def test_the_split_is_along_the_principal_axis():
    gaussians = random_gaussians(1, 2)
    before = torch.linalg.eigh(full_covariance(gaussians).detach()[0])
    middle = torch.cat((gaussians.latent_center, gaussians.center), 1).detach()[0].clone()
    with torch.no_grad():
        split_gaussians(gaussians, torch.tensor([0]), torch.tensor([0]))
    offset = torch.cat((gaussians.latent_center, gaussians.center), 1).detach()[0] - middle
    cosine = (offset @ before.eigenvectors[:, -1]).abs() / offset.norm()
    assert cosine.item() == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_review_brings_the_invisible_back_and_clears_their_memory(share):
    frames = swinging_bar(40)
    autoencoder = small_autoencoder(frames)
    optimizer = make_optimizer(autoencoder, small_config().rate)
    images = to_images(frames)
    (autoencoder.decode(autoencoder.encode(images)) - images).square().mean().backward()
    optimizer.step()
    with torch.no_grad():
        autoencoder.gaussians.precision_log_diagonal.fill_(-3.0)  # all the others are seen everywhere
        autoencoder.gaussians.opacity_logit[:5] = -9.0
    config = LifecycleConfig(every=1, start=0.0, stop=1.0, peak_opacity=0.02, split_share=share)
    assert (
        densify_and_prune(
            autoencoder, optimizer, TrainingFrames(frames), config, rng=np.random.default_rng(0)
        )
        == 5
    )
    latents = autoencoder.encode(images)
    assert (measure_peak_opacity(autoencoder.gaussians, latents) > 0.02).all()
    for name, parameter in autoencoder.gaussians.named_parameters():
        assert torch.isfinite(parameter).all()
        if name != "background_logit":
            idle = (optimizer.state[parameter]["exp_avg"].reshape(len(parameter), -1) == 0).all(1)
            assert idle.sum() >= 5
    assert (
        densify_and_prune(
            autoencoder, optimizer, TrainingFrames(frames), config, rng=np.random.default_rng(0)
        )
        == 0
    )


def test_a_split_hardly_changes_the_picture():
    frames = swinging_bar(40)
    autoencoder, _ = fit_autoencoder(frames, small_config(steps=100), seed=0)
    optimizer = make_optimizer(autoencoder, small_config().rate)
    images = to_images(frames)
    with torch.no_grad():
        # the dead ones come first in the order of drawing, where a careless child would cover everything
        for parameter in autoencoder.gaussians.parameters():
            if len(parameter) == autoencoder.gaussians.n:
                parameter.copy_(torch.cat((parameter[:8], parameter[:-8])))
        autoencoder.gaussians.opacity_logit[:8] = -9.0
        before = autoencoder.decode(autoencoder.encode(images))
        config = LifecycleConfig(every=1, start=0.0, stop=1.0, peak_opacity=0.02, split_share=1.0)
        assert (
            densify_and_prune(
                autoencoder, optimizer, TrainingFrames(frames), config, rng=np.random.default_rng(0)
            )
            == 8
        )
        after = autoencoder.decode(autoencoder.encode(images))
    assert (after - before).square().mean() < 0.05 * before.var()


def test_the_last_part_of_training_is_left_alone():
    config = LifecycleConfig(every=10, start=0.2, stop=0.8, peak_opacity=0.02, split_share=0.5)
    due = [step for step in range(100) if is_due(config, step=step, steps=100)]
    assert due == [29, 39, 49, 59, 69, 79]
    config.every = 0
    assert not any(is_due(config, step=step, steps=100) for step in range(100))
