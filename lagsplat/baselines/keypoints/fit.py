"""Train a key-point forecaster, phase by phase."""

import logging
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch

from lagsplat.array_types import Frames
from lagsplat.baselines.config import PHASES, ForecasterConfig
from lagsplat.baselines.keypoints.model import Forecaster, read_forecaster_architecture, scatter_points
from lagsplat.baselines.keypoints.phases import (
    ForecasterFit,
    TrainingMoment,
    choose_moment,
    forecast_loss,
    open_phase,
    set_rates,
)
from lagsplat.baselines.training import run_training
from lagsplat.io.files.checkpoint import load_checkpoint, save_checkpoint

log = logging.getLogger(__name__)


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
    curve = _restore(fitting, checkpoint, identity)

    def take_step(step: int) -> np.ndarray:
        moment = choose_moment(config, step)
        if moment.inner == 0:
            open_phase(fitting, moment)
        return train_step(fitting, moment, step)

    def make_point(step: int, loss: float, error: float, seconds: float) -> ForecasterCurvePoint:
        return ForecasterCurvePoint(step, choose_moment(config, step - 1).phase, loss, error, seconds)

    run_training(
        take_step,
        curve,
        make_point,
        n_terms=2,
        ends=np.cumsum([config.steps[phase] for phase in PHASES]).tolist(),
        title="forecaster",
        save=partial(_save, fitting, curve, checkpoint, identity) if checkpoint else None,
        save_every_s=config.checkpoint_every_s,
    )
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


def _restore(fitting: ForecasterFit, checkpoint: Path | None, identity: str) -> list[ForecasterCurvePoint]:
    state = load_checkpoint(checkpoint, identity=identity) if checkpoint else None
    if state is None:
        return []
    fitting.forecaster.load_state_dict(state["forecaster"])
    curve = [ForecasterCurvePoint(*row) for row in state["curve"]]
    done = curve[-1].step
    moment = choose_moment(fitting.config, done) if done < fitting.config.n_steps else None
    if moment is not None and moment.inner:
        open_phase(fitting, moment)
        fitting.optimizer.load_state_dict(state["optimizer"])
        fitting.nearest = state["nearest"]
    log.info("going on from %s at step %d", checkpoint, done)
    return curve


def _save(fitting: ForecasterFit, curve: list[ForecasterCurvePoint], checkpoint: Path, identity: str) -> None:
    state = {
        "forecaster": fitting.forecaster.state_dict(),
        "optimizer": fitting.optimizer.state_dict(),
        "nearest": fitting.nearest,
        "curve": [tuple(point) for point in curve],
    }
    save_checkpoint(checkpoint, state, identity=identity)
