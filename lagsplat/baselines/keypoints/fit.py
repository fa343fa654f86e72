"""Train a key-point forecaster, phase by phase: what each phase fits, its loss and its step sizes."""

import logging
import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from lagsplat.array_types import Frames
from lagsplat.baselines.config import PHASES, ForecasterConfig
from lagsplat.baselines.keypoints.model import (
    Forecaster,
    fit_path,
    read_forecaster_architecture,
    scatter_points,
    wrap_angle,
)
from lagsplat.io.files.checkpoint import load_checkpoint, save_checkpoint
from lagsplat.splat.losses import structural_dissimilarity
from lagsplat.stage1.autoencoder import to_images
from lagsplat.stage1.training import run_training

log = logging.getLogger(__name__)
FRESH_NEIGHBOURS = 100  # steps between two searches for the nearest key points


class TrainingMoment(NamedTuple):
    """A step of the training: its phase, the step within it, and the length of the phase."""

    phase: str
    inner: int
    length: int


def choose_moment(config: ForecasterConfig, step: int) -> TrainingMoment:
    """The phase in which a step of the whole training lies."""
    for phase in PHASES:
        if step < config.steps[phase]:
            return TrainingMoment(phase, step, config.steps[phase])
        step -= config.steps[phase]
    raise ValueError(f"step {step} lies past the end of the training")


@dataclass
class ForecasterFit:
    """A forecaster in training, with what lasts for one phase: optimiser, neighbours, series."""

    forecaster: Forecaster
    frames: Tensor  # uint8 (T, H, W, 3)
    config: ForecasterConfig
    seed: int
    optimizer: torch.optim.Optimizer
    nearest: Tensor | None = None
    series: tuple[Tensor, Tensor] | None = None


def open_phase(fitting: ForecasterFit, moment: TrainingMoment) -> None:
    """Begin or resume a phase: a new optimiser and, where a phase needs it, initial key points."""
    forecaster = fitting.forecaster
    if moment.phase == "keys" and moment.inner == 0:
        scene = forecaster.scene
        forecaster.keys.gather(scene.place.detach(), scene.feature.detach(), seed=fitting.seed)
    fitting.nearest = forecaster.nearest() if moment.phase in ("keys", "joint") else None
    if moment.phase == "graph":
        path = fit_path(forecaster, np.arange(len(fitting.frames), dtype=np.float64))
        fitting.series = tuple(torch.from_numpy(part).flatten(1) for part in path)  # type: ignore[assignment]
    fitting.optimizer = _optimizer(forecaster, fitting.config, moment.phase)


def _optimizer(forecaster: Forecaster, config: ForecasterConfig, phase: str) -> torch.optim.Optimizer:
    scene, keys, rate = forecaster.scene, forecaster.keys, config.rate
    looks = [
        {"params": [scene.place], "ends": list(rate.place)},
        {"params": [scene.color_logit, scene.background_logit], "ends": [rate.colour, rate.colour]},
        {"params": [scene.opacity_logit], "ends": [rate.opacity, rate.opacity]},
        {"params": [scene.log_scale, scene.angle], "ends": [rate.scale, rate.scale]},
    ]
    moves = [{"params": list(forecaster.motion.parameters()), "ends": list(rate.motion)}]
    features = [{"params": [scene.feature], "ends": list(rate.motion)}]
    points = [
        {"params": [keys.place, keys.feature], "ends": list(rate.motion)},
        {"params": [keys.blend_logit], "ends": [rate.blend, rate.blend]},
    ]
    nets = [*forecaster.places.parameters(), *forecaster.turns.parameters()]
    groups = {
        "warm_up": looks,
        "free": [*looks, *moves, *features],
        "keys": [*moves, *points],
        "joint": [*looks, *moves, *points],
        "graph": [{"params": nets, "ends": list(config.graph.rate)}],
    }[phase]
    return torch.optim.Adam(groups, lr=1e-3, eps=1e-15)


def set_rates(fitting: ForecasterFit, moment: TrainingMoment) -> None:
    """Set the step sizes: a half cosine for graph networks, a constant factor per step for images."""
    config = fitting.config
    n_image_steps = sum(config.steps[name] for name in PHASES[:-1])
    before = sum(config.steps[name] for name in PHASES[: PHASES.index(moment.phase)])
    for group in fitting.optimizer.param_groups:
        first, last = group["ends"]
        if moment.phase == "graph":
            wave = 0.5 * (1 + math.cos(math.pi * moment.inner / moment.length))
            group["lr"] = last + (first - last) * wave
        else:
            group["lr"] = first * (last / first) ** ((before + moment.inner) / n_image_steps)


def forecast_loss(
    fitting: ForecasterFit, moment: TrainingMoment, rng: np.random.Generator
) -> tuple[Tensor, Tensor]:
    """The loss of one step, and its error: mean absolute colour, or half widths."""
    if moment.phase == "graph":
        return graph_loss(fitting, moment, rng)
    config, forecaster = fitting.config, fitting.forecaster
    frame = int(rng.integers(len(fitting.frames)))
    truth = to_images(fitting.frames[frame : frame + 1])
    scene, keys = forecaster.scene, forecaster.keys
    if moment.phase == "warm_up":
        still = torch.zeros(len(scene.place), 3)
        drawn = forecaster.draw((still[:, :2], still[:, 2:]))
    elif moment.phase == "free":
        noise = _noise(scene.place, fitting, moment, rng)
        drawn = forecaster.draw(forecaster.shift(scene, float(frame), noise=noise))
    else:
        if moment.inner % FRESH_NEIGHBOURS == 0 or fitting.nearest is None:
            fitting.nearest = forecaster.nearest()
        noise = _noise(keys.place, fitting, moment, rng) if moment.phase == "keys" else 0.0
        drawn = forecaster.draw_keys(forecaster.shift(keys, float(frame), noise=noise), fitting.nearest)
    error = (drawn - truth).abs().mean()
    loss = config.l1 * error
    if config.ssim:
        loss = loss + config.ssim * structural_dissimilarity(drawn, truth, window=config.ssim_window)
    if moment.phase == "free":
        loss = loss + config.motion.feature_penalty * scene.feature.abs().mean()
    return loss, error.detach()


def _noise(
    place: nn.Parameter, fitting: ForecasterFit, moment: TrainingMoment, rng: np.random.Generator
) -> Tensor | float:
    """Noise on the places that the network sees; zero after the first third of a phase."""
    sigma = fitting.config.motion.place_noise * max(0.0, 1 - 3 * moment.inner / moment.length)
    if sigma == 0.0:
        return 0.0
    return torch.as_tensor(sigma * rng.standard_normal(tuple(place.shape)), dtype=place.dtype)


def graph_loss(
    fitting: ForecasterFit, moment: TrainingMoment, rng: np.random.Generator
) -> tuple[Tensor, Tensor]:
    """Mean distance of the predicted key points, and of the ends of their rotated unit vectors."""
    assert fitting.series is not None, "the phase was opened"
    config, forecaster = fitting.config.graph, fitting.forecaster
    places, turns = fitting.series
    starts = rng.integers(len(places) - config.history, size=config.batch)
    taps = starts[:, None] + np.arange(config.history + 1)
    noise = config.noise * max(0.0, 1 - moment.inner / (config.noise_until * moment.length))
    errors = []
    for net, series, share in ((forecaster.places, places, 1.0), (forecaster.turns, turns, 0.5)):
        windows = series[torch.from_numpy(taps)]
        past, truth = windows[:, :-1], windows[:, -1]
        if noise:
            drawn = rng.uniform(-noise * share, noise * share, tuple(past.shape))
            past = past + torch.as_tensor(drawn, dtype=past.dtype)
        predicted = net(past)
        if net is forecaster.turns:
            predicted = wrap_angle(predicted)
        # the root's derivative at zero is not finite
        apart = (predicted - truth).unflatten(1, (-1, 2)).square().sum(-1)
        errors.append((apart + 1e-12).sqrt().mean())
    return errors[0] + errors[1], errors[0].detach()


class ForecasterCurvePoint(NamedTuple):
    """Means since the previous point."""

    step: int
    phase: str
    loss: float
    error: float  # mean absolute colour error; in the last phase the distance of key points [half widths]
    seconds: float  # of training in total, without interruptions


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

    ``identity`` identifies the run in the file ``checkpoint``.

    Raises:
        ValueError: fewer frames than the graph networks need for one example.
        FloatingPointError: the loss stops being finite.

    Source: the published forecaster: its phases, their relative lengths, its losses. The number of Gaussians
    does not grow.
    """
    if len(frames) <= config.graph.history:
        raise ValueError(
            f"{len(frames)} training frames in the clip: a forecast from {config.graph.history} frames needs "
            "more; lower forecaster.graph.history or give a longer clip"
        )
    torch.manual_seed(seed)
    _, height, width, _ = frames.shape
    shape = read_forecaster_architecture(config, height=height, width=width, frames=len(frames))
    forecaster = Forecaster(shape, backend=config.backend).train()
    rng = np.random.default_rng(seed)
    scatter_points(forecaster.scene, frames, sigma=config.spatial_sigma, opacity=config.opacity, rng=rng)
    stored = torch.from_numpy(np.array(frames))  # a copy: the file is mapped read-only
    fitting = ForecasterFit(forecaster, stored, config, seed, torch.optim.Adam(forecaster.parameters()))
    curve = _restore(fitting, checkpoint, identity)

    def take_step(step: int) -> np.ndarray:
        moment = choose_moment(config, step)
        if moment.inner == 0:
            open_phase(fitting, moment)
        return train_step(fitting, moment, step)

    def make_point(step: int, loss: float, error: float, seconds: float) -> ForecasterCurvePoint:
        return ForecasterCurvePoint(step, choose_moment(config, step - 1).phase, loss, error, seconds)

    def save() -> None:
        if checkpoint is None:
            return
        state = {
            "forecaster": forecaster.state_dict(),
            "optimizer": fitting.optimizer.state_dict(),
            "nearest": fitting.nearest,
            "curve": [tuple(point) for point in curve],
        }
        save_checkpoint(checkpoint, state, identity=identity)

    run_training(
        take_step,
        curve,
        make_point,
        n_steps=config.n_steps,
        n_terms=2,
        title="forecaster",
        save=save,
        save_every_s=config.checkpoint_every_s,
        ends=np.cumsum([config.steps[phase] for phase in PHASES]).tolist(),
    )
    return forecaster.eval(), curve


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
