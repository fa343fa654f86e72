"""The optimiser of a baseline, and its step sizes and weights along a run.

Everything is a fraction of the run, so that a short one passes through the same stages as the published 300
epochs: warm-up and the early weight are their first five, the drop follows their two hundredth.
"""

import math

import torch

from lagsplat.baselines.config import BaselineLossConfig, BaselineRateConfig
from lagsplat.baselines.model import Baseline
from lagsplat.baselines.oscillators import UNDECAYED

WARMED = ("encoder", "dynamics")


def optimizer_of(baseline: Baseline, config: BaselineRateConfig) -> torch.optim.AdamW:
    """AdamW with a group a part of the model, and one for logarithms, which do not decay."""
    groups = []
    for part in ("encoder", "decoder", "dynamics"):
        named = dict(getattr(baseline, part).named_parameters())
        for decays in (True, False):
            chosen = [value for name, value in named.items() if (name not in UNDECAYED) == decays]
            if chosen:
                decay = config.weight_decay if decays else 0.0
                groups.append({"params": chosen, "weight_decay": decay, "part": part})
    return torch.optim.AdamW(groups, lr=config.peak, foreach=True)


def set_rates(optimizer: torch.optim.Optimizer, config: BaselineRateConfig, *, step: int, steps: int) -> None:
    """Stairs of warm-up for the encoder and the law, then one drop for all parts."""
    for group in optimizer.param_groups:
        warmed = group["part"] in WARMED
        group["lr"] = config.peak * _factor(config, step / steps, warmed=warmed)


def _factor(config: BaselineRateConfig, progress: float, *, warmed: bool) -> float:
    factor = config.drop_factor if progress >= config.drop_at + config.warmup else 1.0
    if warmed and progress < config.warmup:
        stair = math.floor(config.warmup_stairs * progress / config.warmup)
        factor *= config.warmup_start + (1 - config.warmup_start) * stair / config.warmup_stairs
    return factor


def closing_weight(config: BaselineLossConfig, *, step: int, steps: int) -> float:
    """The present weight of the term that compares approaching nodes with approaching maps."""
    return config.closing_early if step < config.closing_from * steps else config.closing
