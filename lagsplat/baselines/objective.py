"""Loss and optimiser of a baseline, with the schedule of its step sizes and weights.

The schedule is in fractions of the run, so that a short run has the same stages as the published 300 epochs:
warm-up and the early weight are the first five, the drop follows the two hundredth.
"""

import math
from typing import NamedTuple

import torch
from torch.nn import functional

from lagsplat.array_types import Images, Inputs, Latents, Scalar
from lagsplat.baselines.config import BaselineLossConfig, BaselineRateConfig
from lagsplat.baselines.model import UNDECAYED, Baseline, Oscillators
from lagsplat.baselines.networks import (
    AttentionDecoder,
    compute_closing_rates,
    compute_moving_centres,
    measure_disagreement,
    penalize_unwarranted_change,
)


class BaselineBatch(NamedTuple):
    """Consecutive frames with their delayed inputs, and frames at rest with theirs."""

    images: Images
    inputs: Inputs
    rest_images: Images
    rest_inputs: Inputs


class BaselineLossTerms(NamedTuple):
    """The unweighted terms of the loss, all means; those that a model lacks are zero."""

    reconstruction: Scalar
    divergence: Scalar
    ahead: Scalar
    latent: Scalar
    steady: Scalar
    attention: Scalar
    closing: Scalar


def compute_loss_terms(
    baseline: Baseline,
    scene: BaselineBatch,
    *,
    generator: torch.Generator | None,
    closing_gradient: float = 1.0,
) -> BaselineLossTerms:
    """Every loss term for one batch; without a ``generator`` latents are means and maps have no noise.

    The encoded velocity is a constant for the dynamics and their targets; gradients flow through it only to
    the attention maps. ``closing_gradient`` is the share of the closing term's gradient that reaches them.
    """
    dt_s = baseline.architecture.dt_s
    # central differences, one-sided at both ends [1/s]
    (rates,) = torch.gradient(scene.images, spacing=dt_s, dim=0)
    mean, log_variance, moving = baseline.encoder.moving(scene.images, rates)
    velocity = moving.detach()
    later, later_velocity = baseline.dynamics(mean, velocity, scene.inputs)
    attention = closing = steady = mean.new_zeros(())
    if isinstance(baseline.decoder, AttentionDecoder):
        attention, closing = _attention_terms(baseline.decoder, mean, moving, rates, closing_gradient)
    if isinstance(baseline.dynamics, Oscillators):
        steady = _steady_term(baseline.dynamics, baseline.encoder(scene.rest_images)[0], scene.rest_inputs)
    drawn = mean
    if generator is not None:
        drawn = mean + (0.5 * log_variance).exp() * torch.randn(mean.shape, generator=generator)
    pictures = baseline.decoder(drawn, generator=generator)
    return BaselineLossTerms(
        reconstruction=functional.mse_loss(pictures, scene.images),
        divergence=-0.5 * (1.0 + log_variance - mean.square() - log_variance.exp()).mean(),
        ahead=functional.mse_loss(baseline.decoder(later[:-1], generator=generator), scene.images[1:]),
        latent=functional.mse_loss(later[:-1], mean[1:])
        + dt_s**2 * functional.mse_loss(later_velocity[:-1], velocity[1:]),
        steady=steady,
        attention=attention,
        closing=closing,
    )


def _steady_term(law: Oscillators, z: Latents, u: Inputs) -> Scalar:
    """Distance of frames at rest from the rest of the law, and their motion in one step from standstill."""
    later, velocity = law(z, torch.zeros_like(z), u)
    off = (z - law.rest).square().mean() + (later - law.rest).square().mean()
    return off + law.dt_s**2 * velocity.square().mean()


def _attention_terms(
    decoder: AttentionDecoder, z: Latents, velocity: Latents, rates: Images, share: float
) -> tuple[Scalar, Scalar]:
    maps, map_rates = torch.func.jvp(decoder.maps, (z,), (velocity,))[:2]
    attention = penalize_unwarranted_change(map_rates, rates)
    if decoder.group != 2:
        return attention, z.new_zeros(())
    # the same values with a share of their gradient
    seen, seen_rates = (share * value + (1.0 - share) * value.detach() for value in (maps, map_rates))
    centres = compute_moving_centres(seen, seen_rates, decoder.places)
    nodes = (z.unflatten(1, (-1, 2)), velocity.detach().unflatten(1, (-1, 2)))
    return attention, measure_disagreement(compute_closing_rates(*nodes), compute_closing_rates(*centres))


def total_loss(terms: BaselineLossTerms, weights: BaselineLossConfig, *, closing: float) -> Scalar:
    """The weighted loss; ``closing`` is the present weight of that term."""
    return (
        terms.reconstruction
        + weights.divergence * terms.divergence
        + weights.ahead * terms.ahead
        + weights.latent * terms.latent
        + weights.steady * terms.steady
        + weights.attention * terms.attention
        + closing * terms.closing
    )


def make_baseline_optimizer(baseline: Baseline, config: BaselineRateConfig) -> torch.optim.AdamW:
    """AdamW with one parameter group per part of the model, and one without decay for logarithms."""
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
    """Set the step sizes: warm-up in steps for the encoder and the dynamics, then one drop for all parts."""
    progress, warmup = step / steps, 1.0
    factor = config.drop_factor if progress >= config.drop_at + config.warmup else 1.0
    if progress < config.warmup:
        stair = math.floor(config.warmup_stairs * progress / config.warmup)
        warmup = config.warmup_start + (1 - config.warmup_start) * stair / config.warmup_stairs
    for group in optimizer.param_groups:
        warmed = group["part"] in ("encoder", "dynamics")
        group["lr"] = config.peak * (factor * warmup if warmed else factor)


def closing_term_weight(config: BaselineLossConfig, *, step: int, steps: int) -> float:
    """The present weight of the term that compares closing rates of nodes and maps."""
    return config.closing_early if step < config.closing_from * steps else config.closing
