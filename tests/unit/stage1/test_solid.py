"""Gaussians of space learn a scene from several sides, see depth, and show sides that nobody trained on."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from lagsplat.splat.projection import make_view
from lagsplat.stage1.autoencoder import Autoencoder, load_autoencoder, save_autoencoder, to_images
from lagsplat.stage1.config import LifecycleConfig
from lagsplat.stage1.fit import fit_autoencoder
from lagsplat.stage1.objective import NovelViewTargets, reconstruct
from lagsplat.stage1.training_data import TrainingFrames, render_depth
from tests.unit.stage1.problems import small_autoencoder, small_config, swinging_bar
from tests.unit.stage1.solid import SUPERVISION, swinging_ball

LIFE = LifecycleConfig(every=60, start=0.2, stop=0.8, peak_opacity=0.02, split_share=0.5)


@pytest.fixture(scope="module")
def trained() -> tuple[Autoencoder, np.ndarray, object]:
    frames, views = swinging_ball(24)
    config = small_config(n_gaussians=150, steps=400, lifecycle=LIFE)
    autoencoder, _ = fit_autoencoder(frames, config, seed=0, novel=views, supervision=SUPERVISION)
    return autoencoder, frames, views


def psnr(drawn: torch.Tensor, truth: torch.Tensor) -> float:
    return float(-10 * (drawn - truth).square().mean().log10())


@torch.no_grad()
def test_sides_that_nobody_trained_on_are_seen_rightly(trained) -> None:
    autoencoder, frames, views = trained
    z = autoencoder.encode(to_images(frames))
    for camera in np.flatnonzero(views.held_out):
        view = make_view([views.space.seen_by(views.cameras[camera])])
        truth = to_images(views.images[:, camera])
        aside = psnr(autoencoder.decode(z, view=view), truth)
        assert aside > 24
        assert aside > psnr(to_images(frames), truth) + 4  # the filmed picture itself, taken for the side


@torch.no_grad()
def test_the_ball_is_nearer_than_the_wall(trained) -> None:
    autoencoder, frames, views = trained
    z = autoencoder.encode(to_images(frames[:1]))
    depth = render_depth(autoencoder, z, autoencoder.filmed_view(z))[0] * views.space.unit
    assert float(depth[9, 12]) == pytest.approx(0.95, abs=0.12)
    assert float(depth[2:16, 2:6].mean()) == pytest.approx(1.2, abs=0.12)


@torch.no_grad()
def test_it_comes_back_from_its_file_and_draws_at_other_sizes(trained, tmp_path) -> None:
    autoencoder, _, views = trained
    save_autoencoder(tmp_path / "autoencoder.safetensors", autoencoder, {})
    back, _ = load_autoencoder(tmp_path / "autoencoder.safetensors")
    z = torch.zeros(1, 1)
    view = make_view([views.space.seen_by(views.cameras[0])])
    assert torch.equal(back.decode(z, view=view), autoencoder.decode(z, view=view))
    large = back.decode(z, view=view, height=72, width=96)
    small = torch.nn.functional.avg_pool2d(large, 4)
    assert psnr(small, back.decode(z, view=view)) > 25


def test_a_hole_in_a_side_teaches_nothing() -> None:
    frames, views = swinging_ball(4)
    footage = TrainingFrames(frames, novel=views, supervision=SUPERVISION)
    sides = footage.sides(np.arange(4), np.random.default_rng(0))
    assert sides is not None
    config = small_config().loss
    autoencoder, _ = fit_autoencoder(
        frames, small_config(n_gaussians=60, steps=5), seed=0, novel=views, supervision=SUPERVISION
    )
    known = torch.ones(4, 1, *frames.shape[1:3])
    known[:, :, :, 12:] = 0
    spoilt = torch.where(known > 0, sides.images, 1 - sides.images)

    def slopes(images: torch.Tensor) -> torch.Tensor:
        autoencoder.zero_grad()
        told = NovelViewTargets(images, known, sides.view, 1.0)
        reconstruct(
            autoencoder, footage.images(np.arange(4)), config, latents=None, sides=told
        ).loss.backward()
        return autoencoder.gaussians.center.grad.clone()

    torch.testing.assert_close(slopes(spoilt), slopes(sides.images))
    assert not torch.allclose(slopes(spoilt), slopes(1 - sides.images))


def test_teleporting_puts_the_invisible_on_what_a_side_shows(trained) -> None:
    from lagsplat.stage1.densification import densify_and_prune, measure_peak_opacity
    from lagsplat.stage1.objective import make_optimizer

    autoencoder, frames, views = trained
    footage = TrainingFrames(frames, novel=views, supervision=SUPERVISION)
    optimizer = make_optimizer(autoencoder, small_config().rate)
    before = {name: value.clone() for name, value in autoencoder.state_dict().items()}
    with torch.no_grad():
        autoencoder.gaussians.opacity_logit[:20] = -9.0
    life = replace(LIFE, every=1, start=0.0, stop=1.0, split_share=0.0)
    assert densify_and_prune(autoencoder, optimizer, footage, life, rng=np.random.default_rng(0)) >= 20
    depth = autoencoder.gaussians.center[:20, 2].detach() * views.space.unit
    latents = footage.latents_of(autoencoder, np.arange(len(frames)))
    assert (measure_peak_opacity(autoencoder.gaussians, latents) > 0.02).all()
    assert ((depth > 0.6) & (depth < 1.6)).all()
    autoencoder.load_state_dict(before)


def test_a_picture_has_no_other_side_and_views_have_settings() -> None:
    frames, views = swinging_ball(4)
    with pytest.raises(ValueError, match="have no other side"):
        small_autoencoder(swinging_bar(8)).decode(torch.zeros(1, 1), view=make_view([views.cameras[0]]))
    with pytest.raises(ValueError, match="come together or not at all"):
        TrainingFrames(frames, novel=views)
    with pytest.raises(ValueError, match="views of 4 instants for 3 frames"):
        TrainingFrames(frames[:3], novel=views, supervision=SUPERVISION)
