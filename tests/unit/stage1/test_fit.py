"""Training: it learns, it is repeatable, and an interruption leaves no trace."""

import numpy as np
import pytest
import torch

from lagsplat.stage1 import fit as fit_module
from lagsplat.stage1.autoencoder import decode_latents, encode_frames, load_autoencoder, save_autoencoder
from lagsplat.stage1.fit import fit_autoencoder
from tests.unit.stage1.problems import small_config, swinging_bar


def weights(autoencoder):
    return torch.cat([value.flatten() for value in autoencoder.state_dict().values()])


def test_training_reduces_the_error_and_opens_the_latent():
    frames = swinging_bar(60)
    autoencoder, curve = fit_autoencoder(frames, small_config(steps=150), seed=0)
    assert curve[-1].mse < 0.15 * curve[0].mse
    latents = encode_frames(autoencoder, frames)[:, 0]
    place = np.sin(np.arange(60) / 3)
    assert abs(np.corrcoef(latents, place)[0, 1]) > 0.95


def test_same_seed_same_bits_other_seed_other_bits():
    frames = swinging_bar(30)
    runs = [fit_autoencoder(frames, small_config(steps=20), seed=seed)[0] for seed in (3, 3, 4)]
    assert torch.equal(weights(runs[0]), weights(runs[1]))
    assert not torch.equal(weights(runs[0]), weights(runs[2]))


def test_a_killed_run_goes_on_to_the_same_bits(tmp_path, monkeypatch):
    frames, config = swinging_bar(30), small_config()
    whole, whole_curve = fit_autoencoder(frames, config, seed=1)

    step_of = fit_module.train_step

    def killed_at_37(autoencoder, optimizer, batch, config, step, *known):
        if step == 37:
            raise KeyboardInterrupt
        return step_of(autoencoder, optimizer, batch, config, step, *known)

    checkpoint = tmp_path / "state.pt"
    with monkeypatch.context() as patch:
        patch.setattr(fit_module, "train_step", killed_at_37)
        with pytest.raises(KeyboardInterrupt):
            fit_autoencoder(frames, config, seed=1, checkpoint=checkpoint, identity="a")
    assert checkpoint.exists()
    steps = []
    with monkeypatch.context() as patch:
        patch.setattr(fit_module, "train_step", lambda *a: (steps.append(a[4]), step_of(*a))[1])
        resumed, curve = fit_autoencoder(frames, config, seed=1, checkpoint=checkpoint, identity="a")
    assert steps[0] > 20
    assert torch.equal(weights(whole), weights(resumed))
    assert curve == whole_curve


def test_a_checkpoint_of_another_run_is_ignored(tmp_path, caplog):
    frames, config, checkpoint = swinging_bar(30), small_config(steps=20), tmp_path / "state.pt"
    fit_autoencoder(frames, config, seed=1, checkpoint=checkpoint, identity="a")
    other, _ = fit_autoencoder(frames, config, seed=2, checkpoint=checkpoint, identity="b")
    fresh, _ = fit_autoencoder(frames, config, seed=2)
    assert torch.equal(weights(other), weights(fresh))
    assert "belongs to other settings" in caplog.text
    checkpoint.write_bytes(checkpoint.read_bytes()[:100])
    fit_autoencoder(frames, config, seed=2, checkpoint=checkpoint, identity="b")
    assert "cannot be read" in caplog.text


def test_a_diverging_loss_stops_with_advice():
    frames = swinging_bar(10)
    config = small_config()
    config.rate.encoder, config.rate.latent_step = 1e30, None
    with pytest.raises(FloatingPointError, match=r"Lower stage1\.rate"):
        fit_autoencoder(frames, config, seed=0)


def test_an_autoencoder_survives_its_file(tmp_path):
    frames = swinging_bar(10)
    autoencoder, _ = fit_autoencoder(frames, small_config(steps=3), seed=0)
    save_autoencoder(tmp_path / "a.safetensors", autoencoder, {"seed": 0})
    loaded, header = load_autoencoder(tmp_path / "a.safetensors")
    assert header["seed"] == 0
    z = encode_frames(loaded, frames)
    assert np.array_equal(z, encode_frames(autoencoder, frames))
    assert np.array_equal(decode_latents(loaded, z), decode_latents(autoencoder, z))


def test_resolution_is_free_at_decoding():
    frames = swinging_bar(10, height=10, width=14)
    autoencoder, _ = fit_autoencoder(frames, small_config(steps=3), seed=0)
    z = encode_frames(autoencoder, frames)
    assert decode_latents(autoencoder, z, height=25, width=40).shape == (10, 3, 25, 40)
    assert decode_latents(autoencoder, z[:0]).shape == (0, 3, 10, 14)


@pytest.mark.parametrize("changes", [{"batch": 1}, {"n_gaussians": 1}, {"d": 3}])
def test_odd_sizes_train(changes):
    _, curve = fit_autoencoder(swinging_bar(1), small_config(steps=5, **changes), seed=0)
    assert np.isfinite([point.loss for point in curve]).all()
