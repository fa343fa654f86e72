"""Training of stage 1: encoder and decoder together, or a decoder alone at given latents."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.array_types import Frames, Latents, Series
from lagsplat.io.files.checkpoint import load_training_state, save_training_state
from lagsplat.splat.image_model import choose_device
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.stage1.config import RenderConfig, Stage1Config
from lagsplat.stage1.densification import densify_and_prune, is_due
from lagsplat.stage1.encoder import limit_latent_step
from lagsplat.stage1.encoder_initialization import SAMPLE, remove_squares
from lagsplat.stage1.gaussian_initialization import initialize_autoencoder
from lagsplat.stage1.linear_response import InputHistory
from lagsplat.stage1.objective import (
    ExpectedLatents,
    NovelViewTargets,
    make_optimizer,
    reconstruct,
    set_rates,
)
from lagsplat.stage1.training import run_training
from lagsplat.stage1.training_data import TrainingFrames
from lagsplat.views.config import SupervisionConfig
from lagsplat.views.novel import NovelViews

STRAIGHTENED_AT = (0.2, 0.35, 0.5, 0.65)
"""Shares of the steps after which latents of a free motion lose their squares: training bends them again.

Set by hand, with the simulated arms in view.
"""
PROBED = 16  # frames of a batch on which the step of the latents is measured


class TrainingCurvePoint(NamedTuple):
    """Means since the previous point of the training curve."""

    step: int
    loss: float
    l1: float
    mse: float
    recycled: int


def fit_autoencoder(
    frames: Frames,
    config: Stage1Config,
    *,
    seed: int,
    checkpoint: Path | None = None,
    identity: str = "",
    latents: Series | None = None,
    novel: NovelViews | None = None,
    supervision: SupervisionConfig | None = None,
    history: InputHistory | None = None,
) -> tuple[Autoencoder, list[TrainingCurvePoint]]:
    """Train encoder and decoder on the training frames, or the decoder alone on given latents.

    Every random draw is a function of the seed and the step, so a run resumed from ``checkpoint`` is
    bit-identical to one that was never interrupted.

    Args:
        checkpoint: File of the training state; None keeps none.
        identity: Digest of all that determines the result; a checkpoint of another identity is ignored.
        latents: Fixed raw latents of the frames; None trains an encoder.
        novel: Novel views of the same instants; with them Gaussians live in space.
        supervision: How these views enter the loss.
        history: Inputs of the frames, which straighten the latents.

    Raises:
        FloatingPointError: the loss is no longer finite.
        ValueError: the views are of other frames.
    """
    device = choose_device(config.backend)
    footage = TrainingFrames(
        frames, device=device, latents=latents, novel=novel, supervision=supervision, history=history
    )
    autoencoder, response = initialize_autoencoder(footage, config, seed=seed)
    autoencoder = autoencoder.to(device)
    optimizer = make_optimizer(autoencoder, config.rate)
    curve = load_training_state(checkpoint, autoencoder, optimizer, TrainingCurvePoint, identity=identity)
    recycled = 0
    free = latents is None and response is None and config.d > 1 and config.init.encoder == "unfolded"
    straightened = {round(share * config.steps) for share in STRAIGHTENED_AT if free}

    def take_step(step: int) -> np.ndarray:
        nonlocal recycled
        rng = np.random.default_rng([seed, step])
        picked = rng.integers(len(footage), size=config.batch)
        batch, known, sides = footage.images(picked), footage.known(picked), footage.sides(picked, rng)
        if step in straightened:
            remove_squares(autoencoder.encoder, footage.images(footage.sample(SAMPLE, seed=seed)))
        set_rates(optimizer, config.rate, step=step, steps=config.steps)
        expected = footage.expect(picked, response)
        terms = train_step(autoencoder, optimizer, batch, config, step, known, sides, expected)
        if is_due(config.lifecycle, step=step, steps=config.steps):
            recycled += densify_and_prune(autoencoder, optimizer, footage, config.lifecycle, rng=rng)
        return terms

    def make_point(step: int, loss: float, l1: float, mse: float, _: float) -> TrainingCurvePoint:
        nonlocal recycled
        recycled, since_last_point = 0, recycled
        return TrainingCurvePoint(step, loss, l1, mse, since_last_point)

    run_training(
        take_step,
        curve,
        make_point,
        n_steps=config.steps,
        n_terms=3,
        title="stage 1",
        save=partial(save_training_state, checkpoint, autoencoder, optimizer, curve, identity=identity),
        save_every_s=config.checkpoint_every_s,
        images_per_step=config.batch,
    )
    return autoencoder.eval(), curve


def fit_decoder(
    frames: Frames,
    latents: Float64[np.ndarray, "N d"],
    stage1: Stage1Config,
    render: RenderConfig,
    *,
    seed: int,
    checkpoint: Path | None = None,
    identity: str = "",
) -> tuple[Autoencoder, list[TrainingCurvePoint]]:
    """Fit Gaussians to ``frames`` at their raw ``latents``, which stay fixed.

    The result draws at the resolution of ``frames``. Its encoder is untrained: encode with the autoencoder
    that made the latents. Step sizes in pixels grow with the resolution.

    ``stage1`` holds the settings that ``render`` lacks; ``seed``, ``checkpoint`` and ``identity`` are as in
    `fit_autoencoder`.

    Raises:
        ValueError: frames and latents differ in number.
        FloatingPointError: the loss is no longer finite.

    Source: paper, Implementation Details (high-resolution renders retrain the decoder alone).
    """
    if len(frames) != len(latents):
        raise ValueError(
            f"{len(frames)} frames and {len(latents)} latents: each frame needs its own; read the same part "
            "of the same recording at the higher resolution"
        )
    settings = replace(
        stage1,
        n_gaussians=render.n_gaussians,
        steps=render.steps,
        batch=render.batch,
        # the encoder is unused, so its filter penalty is off
        loss=replace(stage1.loss, nonlocal_filter=0.0),
        rate=replace(stage1.rate, center=render.factor * stage1.rate.center),
    )
    return fit_autoencoder(
        frames, settings, seed=seed, checkpoint=checkpoint, identity=identity, latents=latents
    )


def train_step(
    autoencoder: Autoencoder,
    optimizer: torch.optim.Optimizer,
    batch: torch.Tensor,
    config: Stage1Config,
    step: int,
    latents: Latents | None = None,
    sides: NovelViewTargets | None = None,
    expected: ExpectedLatents | None = None,
) -> np.ndarray:
    """Take one optimiser step on recorded images; return the loss, mean absolute and mean squared error.

    ``latents``, ``sides`` and ``expected`` are as in `reconstruct`.
    """
    optimizer.zero_grad(set_to_none=True)
    scores = reconstruct(autoencoder, batch, config.loss, latents=latents, sides=sides, expected=expected)
    scores.loss.backward()
    if config.rate.gradient_clip is not None:
        for part in (autoencoder.encoder, autoencoder.gaussians):
            torch.nn.utils.clip_grad_norm_(part.parameters(), config.rate.gradient_clip)
    limit = config.rate.latent_step if latents is None else None
    with limit_latent_step(autoencoder.encoder, batch[:PROBED], limit=limit):
        optimizer.step()
    values = np.array([float(score.detach()) for score in scores])
    if not np.isfinite(values).all():
        raise FloatingPointError(
            f"stage 1 diverged at step {step}: the loss is {values[0]}. "
            f"Lower stage1.rate.* (now {config.rate}) or look for broken frames with `lagsplat inspect`"
        )
    return values
