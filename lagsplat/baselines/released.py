"""Fetch the weights that the authors of the baselines published, and read them into these models.

A published file is a dictionary of ``vae_state_dict``, ``latent_dynamics_state_dict`` and ``epoch``; names
and shapes decide which of the four models it is. Two constants are missing from it and are set here: the
step of the dynamics, and the background's logit, without which the attention decoder silently renders wrong
images. The repository carries no licence, so nothing of it is part of this project, and weights are fetched
only on request.

Source: github.com/UThenrik/visual_oscillators_for_SCR, the last epoch of each run, with the published
configurations of the runs (the defaults beside them differ).
"""

import math
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

from lagsplat.baselines.model import Baseline, BaselineArchitecture
from lagsplat.io.files.artifact import StrPath
from lagsplat.io.files.checkpoint import load_weights
from lagsplat.io.files.download import download

DT_S = 0.01667
SAMPLES = 4
SIDE = 32
NOISE = 0.1
BACKGROUND = {"oscillators": 1.0, "koopman": 3.0}
PARTS = ("vae_state_dict", "latent_dynamics_state_dict")
UNUSED = ("decoder.coord_scale", "decoder.coord_rotation", "decoder.coord_bias")  # of an untrained variant

LAYERS: dict[str, dict[str, str]] = {
    "encoder": {f"convolutions.{i}": f"encoder.{2 * i}" for i in range(3)} | {"head": "encoder.7"},
    "deconv": {"expand": "decoder.0"} | {f"convolutions.{i}": f"decoder.{2 * i + 2}" for i in range(3)},
    "abcd": {
        f"{ours}.layers.{i}": f"decoder.{theirs}.{2 * i}"
        for ours, theirs in (("attention", "attention_net"), ("color", "decoder"))
        for i in range(4)
    },
    "koopman": {f"increment.{i}": f"control_to_state.{2 * i}" for i in range(2)},
    "oscillators": {f"force.{i}": f"osc_net.control_to_state.{2 * i}" for i in range(3)},
}
"""Our name and the published one of each layer, which has a weight and a bias, by part or its kind."""
BACKGROUND_FEATURES, EXPANDERS = "decoder.background_features", "decoder.latent_expanders"
TENSORS: dict[str, dict[str, str]] = {
    "abcd": {
        "background": BACKGROUND_FEATURES,
        "embed_weight": f"{EXPANDERS}.*.weight",
        "embed_bias": f"{EXPANDERS}.*.bias",
    },
    "koopman": {"matrix": "K"},
    "oscillators": {
        "inverse_mass_raw": "osc_net.minv_diag_raw",
        "mass_scale": "osc_net.m_scale",
        "stiffness_scale": "osc_net.k_scale",
        "mass_damping": "osc_net.alpha_raw",
        "stiffness_damping": "osc_net.beta_raw",
        "coupling_raw": "osc_net.k_raw",
        "ground_raw": "osc_net.k_ground_raw",
    },
}
"""The same for every other tensor."""


def load_released(path: StrPath) -> tuple[Baseline, int]:
    """The model in a published file, and the epoch it was saved at.

    Raises:
        FileNotFoundError: nothing is at ``path``.
        ValueError: the file cannot be read safely, is of another layout, or a tensor has another shape.
    """
    content = load_weights(path)
    if missing := [part for part in PARTS if not isinstance(content.get(part), Mapping)]:
        raise ValueError(
            f"{path}: no {missing[0]!r}, only {sorted(map(str, content))[:6]}; this is no published "
            "checkpoint of the baselines. Give a file model_checkpoint.pt of their repository"
        )
    images, law = (content[part] for part in PARTS)
    architecture = _read_architecture(path, images, law)
    if architecture.decoder == "abcd":
        images = _arrange_attention(images, architecture.d)
    names = _list_names(architecture)
    baseline = Baseline(architecture)
    _fill(path, baseline, names, {**images, **law})
    if left := [name for name in images if name not in {*names.values(), *UNUSED}]:
        raise ValueError(
            f"{path}: {len(left)} tensor(s) that this model has no place for, the first {left[0]!r}; the "
            "file is of another version, and reading part of it would be another model"
        )
    return baseline.eval(), int(content.get("epoch", -1))


def _read_architecture(
    path: object, images: Mapping[str, Tensor], law: Mapping[str, Tensor]
) -> BaselineArchitecture:
    dynamics = "koopman" if "K" in law else "oscillators"
    head_name, first_name = "encoder.7.bias", f"{next(iter(LAYERS[dynamics].values()))}.weight"
    head, first = images.get(head_name), law.get(first_name)
    if head is None or first is None:
        raise ValueError(
            f"{path}: no tensor {head_name if head is None else first_name!r}, which gives the size of the "
            "model; the file is of another version, only those with delayed pressures are read"
        )
    return BaselineArchitecture(
        decoder="abcd" if BACKGROUND_FEATURES in images else "deconv",
        dynamics=dynamics,
        d=len(head) // 2,
        n_inputs=first.shape[1] // SAMPLES,
        samples=SAMPLES,
        height=SIDE,
        width=SIDE,
        dt_s=DT_S,
        background=BACKGROUND[dynamics],
        noise=NOISE if dynamics == "oscillators" else 0.0,
    )


def _arrange_attention(images: Mapping[str, Tensor], d: int) -> dict[str, Tensor]:
    """The tensors with rows of pixels in place of an image, and all expanders, if complete, in one."""
    tensors = {name: value for name, value in images.items() if not name.startswith(EXPANDERS)}
    tensors[BACKGROUND_FEATURES] = images[BACKGROUND_FEATURES][0].flatten(1).T
    for what in ("weight", "bias"):
        each = [f"{EXPANDERS}.{i}.{what}" for i in range(d)]
        if all(name in images for name in each):
            tensors[f"{EXPANDERS}.*.{what}"] = torch.stack([images[name].reshape(-1) for name in each])
    return tensors


def _list_names(architecture: BaselineArchitecture) -> dict[str, str]:
    """The published name of each of our tensors."""
    names = {}
    parts = {"encoder": "encoder", "decoder": architecture.decoder, "dynamics": architecture.dynamics}
    for part, kind in parts.items():
        for ours, theirs in LAYERS[kind].items():
            names[f"{part}.{ours}.weight"] = f"{theirs}.weight"
            names[f"{part}.{ours}.bias"] = f"{theirs}.bias"
        names |= {f"{part}.{ours}": theirs for ours, theirs in TENSORS.get(kind, {}).items()}
    if (architecture.decoder, architecture.dynamics) == ("abcd", "oscillators"):
        names["dynamics.rest"] = "osc_net.x0"
    return names


def _fill(path: object, baseline: Baseline, names: dict[str, str], tensors: Mapping[str, Tensor]) -> None:
    weights = baseline.state_dict()
    for ours, theirs in names.items():
        if theirs not in tensors:
            raise ValueError(
                f"{path}: no tensor {theirs!r}, which a model of {baseline.architecture} has; the file is "
                "cut or of another version. Fetch it again"
            )
        value, shape = tensors[theirs], weights[ours].shape
        if value.numel() != math.prod(shape) or (value.ndim == len(shape) and value.shape != shape):
            raise ValueError(
                f"{path}: tensor {theirs!r} is of shape {tuple(value.shape)}, but a model of "
                f"{baseline.architecture} takes {tuple(shape)}; the file is of another version"
            )
        weights[ours] = value.reshape(shape).to(weights[ours].dtype)
    baseline.load_state_dict(weights)


COMMIT = "ef8c5b3f86d02e25c96461d06a8069e45f0d608f"
ADDRESS = f"https://raw.githubusercontent.com/UThenrik/visual_oscillators_for_SCR/{COMMIT}/results/models"
NOTICE = (
    "These weights are of another project, whose repository carries no licence: keep them to yourself. "
    f"Source: {ADDRESS}"
)
RUNS = {
    ("krauss_1seg", "osc_deconv"): "20251028_1647_scr_match_1seg_harmonic1d/epoch_300",
    ("krauss_1seg", "osc_abcd"): "20251029_0441_scr_match_1seg_harmonic2d_vel_attn/further/epoch_300",
    ("krauss_1seg", "koopman_deconv"): "20251028_1647_scr_match_1seg_koopman/epoch_300",
    ("krauss_1seg", "koopman_abcd"): "20251029_1505_scr_match_1seg_koopman_attn/epoch_300",
    ("krauss_2seg", "osc_deconv"): "20251028_1647_scr_match_2seg_harmonic1d/epoch_300",
    ("krauss_2seg", "osc_abcd"): "20251029_1507_scr_match_2seg_harmonic2d_vel_attn/further/epoch_300",
    ("krauss_2seg", "koopman_deconv"): "20251028_1647_scr_match_2seg_koopman/epoch_300",
    ("krauss_2seg", "koopman_abcd"): "20251029_1506_scr_match_2seg_koopman_attn/epoch_300",
}
"""Folder of the weights of each system and each choice of ``conf/baseline``."""
SHA256 = {
    ("krauss_1seg", "osc_deconv"): "8a6aa01a9cea79dd460f2a45a596e1f3d2da8d346d6c7d933be82f2f6b7193c3",
    ("krauss_1seg", "osc_abcd"): "8d298014ed2f141fd8756f5cb6d453a7c1c30c8fdf0d54d55f23c61c18f058db",
    ("krauss_1seg", "koopman_deconv"): "b35db51a4940264405bc591876653b4e4891d0eb32512d243061ca6388bc702b",
    ("krauss_1seg", "koopman_abcd"): "ba25d8c76e55f9c809136e506a34fbf6506159ab68fc03a0edf113b4f087d8e2",
    ("krauss_2seg", "osc_deconv"): "0fdc0c2b318ce0de37bb487821046d7c07442278d16d462399bb339ab3b3744f",
    ("krauss_2seg", "osc_abcd"): "1e094fbfb29a8169bb1bfc39f472abd97a2638c6bab71ed4644976d48bac654e",
    ("krauss_2seg", "koopman_deconv"): "ba8aa6f98d57cca6270ff2ffa25fe4ec2e2e24665217a7cd2b3dfd1cee8fbab6",
    ("krauss_2seg", "koopman_abcd"): "648fcaf8d2b94824454a20b63092689e6f773f2ec9a1b427a01572ff883a3b37",
}


def release_url(system: str, baseline: str) -> str:
    """Address of the published weights of ``baseline`` for ``system``."""
    return f"{ADDRESS}/{RUNS[system, baseline]}/model_checkpoint.pt"


def fetch_weights(folder: StrPath) -> list[Path]:
    """All published weights as ``folder/SYSTEM/BASELINE.pt``, for ``baseline.weights=folder``; checked."""
    return [
        download(release_url(system, name), Path(folder) / system / f"{name}.pt", sha256=digest)
        for (system, name), digest in SHA256.items()
    ]
