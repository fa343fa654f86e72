"""The published layout, written by hand: what is read, and what is refused with a reason."""

import pytest
import torch

from lagsplat.baselines.model import Baseline
from lagsplat.baselines.released import load_released


def published(dynamics="oscillators", d=8, n_inputs=2):
    """Random weights under the published names, of a model with attention."""
    group = 2 if dynamics == "oscillators" else 1
    nodes, wide = d // group, 8 * group
    shapes = {f"encoder.{i}": s for i, s in zip((0, 2, 4), ((32, 3), (64, 32), (128, 64)), strict=True)}
    layers = {name: (*shape, 4, 4) for name, shape in shapes.items()} | {"encoder.7": (2 * d, 2048)}
    layers |= {"decoder.attention_net.0": (128, d + 2, 1, 1), "decoder.attention_net.2": (64, 128, 1, 1)}
    layers |= {"decoder.attention_net.4": (64, 64, 1, 1), "decoder.attention_net.6": (nodes, 64, 1, 1)}
    layers |= {"decoder.decoder.0": (64, wide + 2, 1, 1), "decoder.decoder.6": (3, 64, 1, 1)}
    layers |= {f"decoder.decoder.{i}": (64, 64, 1, 1) for i in (2, 4)}
    layers |= {f"decoder.latent_expanders.{i}": (8, 1) for i in range(d)}
    images = {f"{name}.weight": torch.randn(shape) for name, shape in layers.items()}
    images |= {f"{name}.bias": torch.randn(shape[0]) for name, shape in layers.items()}
    images["decoder.background_features"] = torch.randn(1, wide, 32, 32)
    fed = 4 * n_inputs
    if dynamics == "koopman":
        sizes = {"0": (16, fed), "2": (2 * d, 16)}
        law, prefix = {"K": torch.randn(2 * d, 2 * d)}, ""
    else:
        images |= {"decoder.coord_scale": torch.ones(2), "decoder.coord_rotation": torch.zeros(())}
        sizes = {"0": (32, fed), "2": (32, 32), "4": (d, 32)}
        names = ("m_scale", "k_scale", "alpha_raw", "beta_raw")
        law = {f"osc_net.{name}": torch.randn(1) for name in names}
        law |= {"osc_net.minv_diag_raw": torch.randn(nodes), "osc_net.k_raw": torch.randn(d, d)}
        law |= {"osc_net.k_ground_raw": torch.randn(d), "osc_net.x0": torch.randn(d)}
        prefix = "osc_net."
    for layer, shape in sizes.items():
        law[f"{prefix}control_to_state.{layer}.weight"] = torch.randn(shape)
        law[f"{prefix}control_to_state.{layer}.bias"] = torch.randn(shape[0])
    return {"vae_state_dict": images, "latent_dynamics_state_dict": law, "epoch": 300}


@pytest.mark.parametrize(("dynamics", "background"), [("oscillators", 1.0), ("koopman", 3.0)])
def test_every_tensor_finds_its_place(tmp_path, dynamics, background):
    content = published(dynamics)
    torch.save(content, tmp_path / "a.pt")
    baseline, epoch = load_released(tmp_path / "a.pt")
    assert epoch == 300
    assert (baseline.architecture.decoder, baseline.architecture.dynamics) == ("abcd", dynamics)
    assert (baseline.architecture.d, baseline.architecture.n_inputs) == (8, 2)
    assert baseline.decoder.background_logit == background  # in no list of weights
    images = content["vae_state_dict"]
    before = Baseline(baseline.architecture).state_dict()
    assert all(not torch.equal(value, before[name]) for name, value in baseline.state_dict().items())
    place = baseline.decoder.background.T.reshape(1, -1, 32, 32)
    assert torch.equal(place, images["decoder.background_features"])
    third = images["decoder.latent_expanders.3.weight"][:, 0]
    assert torch.equal(baseline.decoder.embed_weight[3], third)


def changed(content, part, name, value):
    tensors = dict(content[part])
    if value is None:
        del tensors[name]
    else:
        tensors[name] = value
    return {**content, part: tensors}


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("decoder.color_net.0.weight", torch.ones(2), "no place for"),
        ("encoder.2.weight", torch.ones(64, 32, 3, 3), "takes"),
        ("encoder.4.bias", None, r"no tensor 'encoder\.4\.bias'"),
        ("encoder.7.bias", None, "size of the model"),
        ("decoder.latent_expanders.5.weight", None, "latent_expanders"),
    ],
)
def test_another_version_is_refused_by_name(tmp_path, name, value, words):
    torch.save(changed(published(), "vae_state_dict", name, value), tmp_path / "a.pt")
    with pytest.raises(ValueError, match=words):
        load_released(tmp_path / "a.pt")


def test_other_files_are_refused(tmp_path):
    torch.save({"state_dict": {}}, tmp_path / "d.pt")
    with pytest.raises(ValueError, match="vae_state_dict"):
        load_released(tmp_path / "d.pt")
