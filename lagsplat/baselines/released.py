"""Weights that the authors of the baselines published, read into these models.

A published file is a dictionary of ``vae_state_dict``, ``latent_dynamics_state_dict`` and ``epoch``. Names
and shapes decide which of the four models it is. Two things are not in it and stand here: the step of the
law, and the background's logit, without which the attention decoder draws wrong images and says nothing.

Source: the published configurations of the runs (not the defaults beside them, which differ).
"""

import math
import os
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from lagsplat.baselines.model import Architecture, Baseline
from lagsplat.io.weights import load_weights

DT_S = 0.01667
SAMPLES = 4
SIDE = 32
NOISE = 0.1
BACKGROUND = {"oscillators": 1.0, "koopman": 3.0}
PARTS = ("vae_state_dict", "latent_dynamics_state_dict")
UNUSED = ("decoder.coord_scale", "decoder.coord_rotation", "decoder.coord_bias")
"""Left over in some files from a variant that was never trained."""

LAYERS = {
    "encoder": {
        "encoder": {"convolutions.0": "0", "convolutions.1": "2", "convolutions.2": "4", "head": "7"}
    },
    "deconv": {
        "decoder": {"expand": "0", "convolutions.0": "2", "convolutions.1": "4", "convolutions.2": "6"}
    },
    "abcd": {
        "decoder": {
            f"{ours}.layers.{layer}": f"{theirs}.{2 * layer}"
            for ours, theirs in (("attention", "attention_net"), ("color", "decoder"))
            for layer in range(4)
        }
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


def _architecture(path: object, images: Mapping[str, Tensor], law: Mapping[str, Tensor]) -> Architecture:
    head, fed = images.get("encoder.7.bias"), "control_to_state.0.weight"
    dynamics = "koopman" if "K" in law else "oscillators"
    first = law.get(fed if dynamics == "koopman" else f"osc_net.{fed}")
    if head is None or first is None:
        lacking = "'encoder.7.bias'" if head is None else f"'{fed}'"
        raise ValueError(
            f"{path}: no tensor {lacking}, so the size of the model cannot be told; the file is of "
            "another version of the baselines, only those with delayed pressures are read"
        )
    return Architecture(
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
    images: Mapping[str, Tensor], law: Mapping[str, Tensor], architecture: Architecture
) -> dict[str, tuple[str, Tensor | None]]:
    """Our name of every weight, with theirs and its value."""
    names: dict[str, tuple[str, Mapping[str, Tensor]]] = {}
    for kind in ("encoder", architecture.decoder):
        for part, layers in LAYERS[kind].items():
            for ours, theirs in layers.items():
                for what in ("weight", "bias"):
                    names[f"{part}.{ours}.{what}"] = (f"{part}.{theirs}.{what}", images)
    if architecture.decoder == "abcd":
        names["decoder.background"] = ("decoder.background_features", images)
    names |= {ours: (theirs, law) for ours, theirs in _law_names(architecture).items()}
    found: dict[str, tuple[str, Tensor | None]] = {
        ours: (theirs, source.get(theirs)) for ours, (theirs, source) in names.items()
    }
    if architecture.decoder == "abcd":
        for what in ("weight", "bias"):
            each = [f"decoder.latent_expanders.{i}.{what}" for i in range(architecture.d)]
            rows = [images[name].reshape(-1) for name in each if name in images]
            complete = torch.stack(rows) if len(rows) == architecture.d else None
            found[f"decoder.embed_{what}"] = (each[0][: each[0].rindex("0")] + f"*.{what}", complete)
    return found


def _law_names(architecture: Architecture) -> dict[str, str]:
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
