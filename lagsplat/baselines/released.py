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
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from lagsplat.baselines.model import Baseline, BaselineArchitecture
from lagsplat.io.files.checkpoint import load_weights
from lagsplat.io.files.download import download

DT_S = 0.01667
SAMPLES = 4
SIDE = 32
NOISE = 0.1
BACKGROUND = {"oscillators": 1.0, "koopman": 3.0}
PARTS = ("vae_state_dict", "latent_dynamics_state_dict")
UNUSED = ("decoder.coord_scale", "decoder.coord_rotation", "decoder.coord_bias")  # of an untrained variant

LAYERS = {
    "encoder": {"convolutions.0": "0", "convolutions.1": "2", "convolutions.2": "4", "head": "7"},
    "deconv": {"expand": "0", "convolutions.0": "2", "convolutions.1": "4", "convolutions.2": "6"},
    "abcd": {
        f"{ours}.layers.{layer}": f"{theirs}.{2 * layer}"
        for ours, theirs in (("attention", "attention_net"), ("color", "decoder"))
        for layer in range(4)
    },
}
OSCILLATORS = {
    "inverse_mass_raw": "osc_net.minv_diag_raw",
    "mass_scale": "osc_net.m_scale",
    "stiffness_scale": "osc_net.k_scale",
    "mass_damping": "osc_net.alpha_raw",
    "stiffness_damping": "osc_net.beta_raw",
    "coupling_raw": "osc_net.k_raw",
    "ground_raw": "osc_net.k_ground_raw",
}


def load_released(path: str | os.PathLike[str]) -> tuple[Baseline, int]:
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
    architecture = _architecture(path, images, law)
    baseline = Baseline(architecture)
    tensors = _renamed(images, law, architecture)
    _fill(path, baseline, tensors)
    _require_all_read(path, images, tensors)
    return baseline.eval(), int(content.get("epoch", -1))


def _architecture(
    path: object, images: Mapping[str, Tensor], law: Mapping[str, Tensor]
) -> BaselineArchitecture:
    head, fed = images.get("encoder.7.bias"), "control_to_state.0.weight"
    dynamics = "koopman" if "K" in law else "oscillators"
    first = law.get(fed if dynamics == "koopman" else f"osc_net.{fed}")
    if head is None or first is None:
        lacking = "'encoder.7.bias'" if head is None else f"'{fed}'"
        raise ValueError(
            f"{path}: no tensor {lacking}, which gives the size of the model; the file is of another version "
            "of the baselines, only those with delayed pressures are read"
        )
    return BaselineArchitecture(
        decoder="abcd" if "decoder.background_features" in images else "deconv",
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


def _renamed(
    images: Mapping[str, Tensor], law: Mapping[str, Tensor], architecture: BaselineArchitecture
) -> dict[str, tuple[str, Tensor | None]]:
    """Our name of every weight, with the published name and its value."""
    names: dict[str, tuple[str, Mapping[str, Tensor]]] = {}
    for part, kind in (("encoder", "encoder"), ("decoder", architecture.decoder)):
        for ours, theirs in LAYERS[kind].items():
            for what in ("weight", "bias"):
                names[f"{part}.{ours}.{what}"] = (f"{part}.{theirs}.{what}", images)
    if architecture.decoder == "abcd":
        names["decoder.background"] = ("decoder.background_features", images)
    names |= {ours: (theirs, law) for ours, theirs in _law_names(architecture).items()}
    tensors: dict[str, tuple[str, Tensor | None]] = {
        ours: (theirs, source.get(theirs)) for ours, (theirs, source) in names.items()
    }
    if architecture.decoder == "abcd":
        for what in ("weight", "bias"):
            each = [f"decoder.latent_expanders.{i}.{what}" for i in range(architecture.d)]
            rows = [images[name].reshape(-1) for name in each if name in images]
            complete = torch.stack(rows) if len(rows) == architecture.d else None
            tensors[f"decoder.embed_{what}"] = (each[0][: each[0].rindex("0")] + f"*.{what}", complete)
    return tensors


def _law_names(architecture: BaselineArchitecture) -> dict[str, str]:
    if architecture.dynamics == "koopman":
        names, layers, prefix = {"matrix": "K"}, ("increment", 2), ""
    else:
        names, layers, prefix = dict(OSCILLATORS), ("force", 3), "osc_net."
        if architecture.decoder == "abcd":
            names["rest"] = "osc_net.x0"
    ours, count = layers
    for layer in range(count):
        for what in ("weight", "bias"):
            names[f"{ours}.{layer}.{what}"] = f"{prefix}control_to_state.{2 * layer}.{what}"
    return {f"dynamics.{name}": theirs for name, theirs in names.items()}


def _fill(path: object, baseline: Baseline, tensors: Mapping[str, tuple[str, Tensor | None]]) -> None:
    wanted = baseline.state_dict()
    for ours, (theirs, value) in tensors.items():
        if value is None:
            raise ValueError(
                f"{path}: no tensor {theirs!r}, which a model of {baseline.architecture} has; the file is "
                "cut or of another version. Fetch it again"
            )
        if theirs == "decoder.background_features":
            value = value[0].flatten(1).T  # theirs are images, ours rows of pixels
        shape = wanted[ours].shape
        if value.numel() != math.prod(shape) or (value.ndim == len(shape) and value.shape != shape):
            raise ValueError(
                f"{path}: tensor {theirs!r} is of shape {tuple(value.shape)}, but a model of "
                f"{baseline.architecture} takes {tuple(shape)}; the file is of another version"
            )
        wanted[ours] = value.reshape(shape).to(wanted[ours].dtype)
    baseline.load_state_dict(wanted)


def _require_all_read(
    path: object, images: Mapping[str, Any], tensors: Mapping[str, tuple[str, Tensor | None]]
) -> None:
    read = {theirs for theirs, _ in tensors.values()} | set(UNUSED)
    left = [name for name in images if name not in read and not name.startswith("decoder.latent_expanders.")]
    if left:
        raise ValueError(
            f"{path}: {len(left)} tensor(s) that this model has no place for, the first {left[0]!r}; the "
            "file is of another version, and reading part of it would be another model"
        )


COMMIT = "ef8c5b3f86d02e25c96461d06a8069e45f0d608f"
ADDRESS = f"https://raw.githubusercontent.com/UThenrik/visual_oscillators_for_SCR/{COMMIT}/results/models"
NOTICE = (
    "These weights are of another project, whose repository carries no licence: keep them to yourself. "
    f"Source: {ADDRESS}"
)
FILES: dict[tuple[str, str], tuple[str, str]] = {
    ("krauss_1seg", "osc_deconv"): (
        "20251028_1647_scr_match_1seg_harmonic1d/epoch_300",
        "8a6aa01a9cea79dd460f2a45a596e1f3d2da8d346d6c7d933be82f2f6b7193c3",
    ),
    ("krauss_1seg", "osc_abcd"): (
        "20251029_0441_scr_match_1seg_harmonic2d_vel_attn/further/epoch_300",
        "8d298014ed2f141fd8756f5cb6d453a7c1c30c8fdf0d54d55f23c61c18f058db",
    ),
    ("krauss_1seg", "koopman_deconv"): (
        "20251028_1647_scr_match_1seg_koopman/epoch_300",
        "b35db51a4940264405bc591876653b4e4891d0eb32512d243061ca6388bc702b",
    ),
    ("krauss_1seg", "koopman_abcd"): (
        "20251029_1505_scr_match_1seg_koopman_attn/epoch_300",
        "ba25d8c76e55f9c809136e506a34fbf6506159ab68fc03a0edf113b4f087d8e2",
    ),
    ("krauss_2seg", "osc_deconv"): (
        "20251028_1647_scr_match_2seg_harmonic1d/epoch_300",
        "0fdc0c2b318ce0de37bb487821046d7c07442278d16d462399bb339ab3b3744f",
    ),
    ("krauss_2seg", "osc_abcd"): (
        "20251029_1507_scr_match_2seg_harmonic2d_vel_attn/further/epoch_300",
        "1e094fbfb29a8169bb1bfc39f472abd97a2638c6bab71ed4644976d48bac654e",
    ),
    ("krauss_2seg", "koopman_deconv"): (
        "20251028_1647_scr_match_2seg_koopman/epoch_300",
        "ba8aa6f98d57cca6270ff2ffa25fe4ec2e2e24665217a7cd2b3dfd1cee8fbab6",
    ),
    ("krauss_2seg", "koopman_abcd"): (
        "20251029_1506_scr_match_2seg_koopman_attn/epoch_300",
        "648fcaf8d2b94824454a20b63092689e6f773f2ec9a1b427a01572ff883a3b37",
    ),
}
"""Run and SHA-256 of the weights of each system and each choice of ``conf/baseline``."""


def release_url(system: str, baseline: str) -> str:
    """Address of the published weights of ``baseline`` for ``system``."""
    return f"{ADDRESS}/{FILES[system, baseline][0]}/model_checkpoint.pt"


def fetch_weights(folder: str | os.PathLike[str]) -> list[Path]:
    """All published weights as ``folder/SYSTEM/BASELINE.pt``, for ``baseline.weights=folder``; checked."""
    return [
        download(release_url(system, name), Path(folder) / system / f"{name}.pt", sha256=digest)
        for (system, name), (_, digest) in FILES.items()
    ]
