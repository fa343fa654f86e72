"""The step sizes of stage 1 along a run."""

import math

import torch

from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.stage1.config import RateConfig


def optimizer_of(autoencoder: Autoencoder, config: RateConfig) -> torch.optim.Adam:
    """Adam with one group for the encoder, one for what is measured in pixels, one for the rest."""
    in_pixels = ("center", "coupling")
    gaussians = dict(autoencoder.gaussians.named_parameters())
    groups = [
        {"params": list(autoencoder.encoder.parameters()), "peak": config.encoder},
        {"params": [gaussians[name] for name in in_pixels], "peak": config.center},
        {
            "params": [value for name, value in gaussians.items() if name not in in_pixels],
            "peak": config.gaussian,
        },
    ]
    return torch.optim.Adam(groups, fused=True)


def set_rates(optimizer: torch.optim.Optimizer, config: RateConfig, *, step: int, steps: int) -> None:
    """Linear warm-up, then a half cosine from each group's peak rate down to its final fraction."""
    for group in optimizer.param_groups:
        group["lr"] = group["peak"] * factor_at(config, step=step, steps=steps)


def factor_at(config: RateConfig, *, step: int, steps: int) -> float:
    """The share of its peak that every rate has at a step."""
    warmup = min(1.0, (step + 1) / max(config.warmup_steps, 1))
    cosine = 0.5 * (1 + math.cos(math.pi * step / steps))
    return warmup * (config.final_fraction + (1 - config.final_fraction) * cosine)
