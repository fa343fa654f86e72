"""Train a key-point forecaster, phase by phase."""

import logging
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from tqdm import tqdm

from lagsplat.array_types import Frames
from lagsplat.baselines.config import ForecasterConfig
from lagsplat.baselines.keypoints.model import Forecaster, read_forecaster_architecture, scatter_points
from lagsplat.baselines.keypoints.phases import (
    ForecasterFit,
    TrainingMoment,
    choose_moment,
    forecast_loss,
    open_phase,
    set_rates,
)
from lagsplat.io.files.checkpoint import load_checkpoint, save_checkpoint

log = logging.getLogger(__name__)
CURVE_POINTS = 400  # rows of the training curve, for a run of any length


class ForecasterCurvePoint(NamedTuple):
    """Means since the previous point; ``seconds`` is the total training time without interruptions.

    ``error`` is the mean absolute colour error, in the last phase the distance of key points [half widths].
    """

    step: int
    phase: str
    loss: float
    error: float
    seconds: float


def fit_forecaster(
    frames: Frames,
    config: ForecasterConfig,
    *,
    seed: int,
    checkpoint: Path | None = None,
    identity: str = "",
) -> tuple[Forecaster, list[ForecasterCurvePoint]]:
    """Train scene, key points and graph networks on the consecutive training frames of one clip.

    Every random draw is a function of the seed and the step, so a run resumed from ``checkpoint`` ends with
    the same bits as an uninterrupted one.

    Args:
        frames, config, seed: training frames, settings, and the random seed.
        checkpoint, identity: file to resume from, and the string that identifies the run in it.

    Raises:
        ValueError: fewer frames than the graph networks need for one example.
        FloatingPointError: the loss stops being finite.

    Source: the published forecaster: its phases, their relative lengths, its losses. The number of Gaussians
    does not grow.
    """
    fitting = _begin(frames, config, seed)
    first, curve = _restore(fitting, checkpoint, identity)
    sums, counted, saved_at = np.zeros(2), 0, time.monotonic()
    spent, resumed_at = curve[-1].seconds if curve else 0.0, time.monotonic()
    every = max(1, config.n_steps // CURVE_POINTS)
    with tqdm(total=config.n_steps, initial=first, unit="step", desc="forecaster", mininterval=1.0) as bar:
        for step in range(first, config.n_steps):
            moment = choose_moment(config, step)
            if moment.inner == 0:
                open_phase(fitting, moment)
            sums += train_step(fitting, moment, step)
            counted += 1
            bar.update()
            ends = moment.inner + 1 == moment.length
            if (step + 1) % every == 0 or ends:
                seconds = spent + time.monotonic() - resumed_at
                curve.append(
                    ForecasterCurvePoint._make([step + 1, moment.phase, *(sums / counted).tolist(), seconds])
                )
                bar.set_postfix(phase=moment.phase, error=f"{curve[-1].error:.3g}")
                sums, counted = np.zeros(2), 0
                # The running means are empty only here, so a checkpoint need not hold them.
                if checkpoint and time.monotonic() - saved_at > config.checkpoint_every_s:
                    _save(fitting, curve, checkpoint, identity)
                    saved_at = time.monotonic()
    return fitting.forecaster.eval(), curve


def _begin(frames: Frames, config: ForecasterConfig, seed: int) -> ForecasterFit:
    if len(frames) <= config.graph.history:
        raise ValueError(
            f"{len(frames)} training frames in the clip: a forecast from {config.graph.history} frames needs "
            "more; lower forecaster.graph.history or give a longer clip"
        )
    torch.manual_seed(seed)
    _, height, width, _ = frames.shape
    of = read_forecaster_architecture(config, height=height, width=width, frames=len(frames))
    forecaster = Forecaster(of, backend=config.backend).train()
    rng = np.random.default_rng(seed)
    scatter_points(forecaster.scene, frames, sigma=config.spatial_sigma, opacity=config.opacity, rng=rng)
    stored = torch.from_numpy(np.array(frames))  # a copy: the file is mapped read-only
    nothing = torch.optim.Adam(forecaster.parameters())
    return ForecasterFit(forecaster, stored, config, seed, nothing)


def train_step(fitting: ForecasterFit, moment: TrainingMoment, step: int) -> np.ndarray:
    """One gradient step; returns its loss and error."""
    rng = np.random.default_rng([fitting.seed, step])
    set_rates(fitting, moment)
    fitting.optimizer.zero_grad(set_to_none=True)
    loss, error = forecast_loss(fitting, moment, rng)
    loss.backward()
    fitting.optimizer.step()
    values = np.array([float(loss.detach()), float(error)])
    if not np.isfinite(values).all():
        raise FloatingPointError(
            f"the forecaster lost its footing at step {step} ({moment.phase}): the loss is {values[0]}. "
            "Lower forecaster.rate.* or look for broken frames with `lagsplat inspect`"
        )
    return values


def _restore(
    fitting: ForecasterFit, checkpoint: Path | None, identity: str
) -> tuple[int, list[ForecasterCurvePoint]]:
    state = load_checkpoint(checkpoint, identity=identity) if checkpoint else None
    if state is None:
        return 0, []
    fitting.forecaster.load_state_dict(state["forecaster"])
    curve = [ForecasterCurvePoint(*row) for row in state["curve"]]
    moment = (
        choose_moment(fitting.config, curve[-1].step) if curve[-1].step < fitting.config.n_steps else None
    )
    if moment is not None and moment.inner:
        open_phase(fitting, moment)
        fitting.optimizer.load_state_dict(state["optimizer"])
        fitting.nearest = state["nearest"]
    log.info("going on from %s at step %d", checkpoint, curve[-1].step)
    return curve[-1].step, curve


def _save(fitting: ForecasterFit, curve: list[ForecasterCurvePoint], checkpoint: Path, identity: str) -> None:
    state: dict[str, Any] = {
        "forecaster": fitting.forecaster.state_dict(),
        "optimizer": fitting.optimizer.state_dict(),
        "nearest": fitting.nearest,
        "curve": [tuple(point) for point in curve],
    }
    save_checkpoint(checkpoint, state, identity=identity)
