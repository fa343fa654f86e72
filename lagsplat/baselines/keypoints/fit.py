"""Train a key-point forecaster, phase by phase: what each phase fits, its loss and its step sizes."""

import logging
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from lagsplat.array_types import Frames
from lagsplat.baselines.config import PHASES, ForecasterConfig
from lagsplat.baselines.keypoints import model
from lagsplat.baselines.keypoints.model import Forecaster
from lagsplat.io.files.checkpoint import load_checkpoint, save_checkpoint
from lagsplat.splat.losses import structural_dissimilarity
from lagsplat.stage1.autoencoder import to_images
from lagsplat.stage1.training import decay_by_cosine, run_training

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
    the same bits as an uninterrupted one. ``identity`` identifies the run in that file.

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
    fitting = ForecasterFit(frames, config, seed)
    state = load_checkpoint(checkpoint, identity=identity) if checkpoint else None
    curve: list[ForecasterCurvePoint] = []
    if state is not None:
        curve += [ForecasterCurvePoint(*row) for row in state["curve"]]
        fitting.load_state_dict(state, done=curve[-1].step)
        log.info("going on from %s at step %d", checkpoint, curve[-1].step)

    def make_point(step: int, loss: float, error: float, seconds: float) -> ForecasterCurvePoint:
        return ForecasterCurvePoint(step, choose_moment(config, step - 1).phase, loss, error, seconds)

    def save() -> None:
        if checkpoint is not None:
            state = {**fitting.state_dict(), "curve": [tuple(point) for point in curve]}
            save_checkpoint(checkpoint, state, identity=identity)

    run_training(
        fitting.take_step,
        curve,
        make_point,
        n_steps=config.n_steps,
        n_terms=2,
        title="forecaster",
        save=save,
        save_every_s=config.checkpoint_every_s,
        ends=np.cumsum([config.steps[phase] for phase in PHASES]).tolist(),
    )
    return fitting.forecaster.eval(), curve


class ForecasterFit:
    """A forecaster in training, with what lasts for one phase: optimiser, neighbours, key points."""

    def __init__(self, frames: Frames, config: ForecasterConfig, seed: int) -> None:
        torch.manual_seed(seed)
        _, height, width, _ = frames.shape
        shape = model.read_forecaster_architecture(config, height=height, width=width, frames=len(frames))
        self.forecaster = Forecaster(shape, backend=config.backend).train()
        self.scene, self.keys = self.forecaster.scene, self.forecaster.keys
        rng = np.random.default_rng(seed)
        look = {"sigma": config.spatial_sigma, "opacity": config.opacity}
        model.place_key_point_scene(self.scene, frames, **look, rng=rng)
        self.frames = torch.from_numpy(np.array(frames))  # a copy: the file is mapped read-only
        self.config, self.seed = config, seed
        self.optimizer: torch.optim.Optimizer = torch.optim.Adam(self.forecaster.parameters())
        self.nearest: Tensor | None = None
        self.series: list[Tensor] = []

    def state_dict(self) -> dict[str, Any]:
        """What a resumed run needs."""
        return {
            "forecaster": self.forecaster.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "nearest": self.nearest,
        }

    def load_state_dict(self, state: dict[str, Any], *, done: int) -> None:
        """Restore the state after ``done`` steps; at the end of a phase the next one begins anew."""
        self.forecaster.load_state_dict(state["forecaster"])
        if done < self.config.n_steps and (moment := choose_moment(self.config, done)).inner:
            self.open_phase(moment)
            self.optimizer.load_state_dict(state["optimizer"])
            self.nearest = state["nearest"]

    def open_phase(self, moment: TrainingMoment) -> None:
        """Begin or resume a phase: a new optimiser and, where a phase needs it, initial key points."""
        scene, forecaster = self.scene, self.forecaster
        if moment.phase == "keys" and moment.inner == 0:
            self.keys.gather(scene.place.detach(), scene.feature.detach(), seed=self.seed)
        self.nearest = forecaster.nearest() if moment.phase in ("keys", "joint") else None
        if moment.phase == "graph":
            path = model.fit_path(forecaster, np.arange(len(self.frames), dtype=np.float64))
            self.series = [torch.from_numpy(part).flatten(1) for part in path]
        groups = self._group_parameters(moment.phase)
        self.optimizer = torch.optim.Adam(groups, lr=1e-3, eps=1e-15)

    def _group_parameters(self, phase: str) -> list[dict[str, Any]]:
        """Parameters that a phase fits, with their first and last step size."""
        scene, keys, forecaster, rate = self.scene, self.keys, self.forecaster, self.config.rate
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
        return {
            "warm_up": looks,
            "free": [*looks, *moves, *features],
            "keys": [*moves, *points],
            "joint": [*looks, *moves, *points],
            "graph": [{"params": nets, "ends": list(self.config.graph.rate)}],
        }[phase]

    def take_step(self, step: int) -> np.ndarray:
        """One gradient step of the whole training; returns its loss and error."""
        moment = choose_moment(self.config, step)
        if moment.inner == 0:
            self.open_phase(moment)
        self._set_rates(moment)
        self.optimizer.zero_grad(set_to_none=True)
        compute_loss = self.graph_loss if moment.phase == "graph" else self.image_loss
        loss, error = compute_loss(moment, np.random.default_rng([self.seed, step]))
        loss.backward()
        self.optimizer.step()
        values = np.array([float(loss.detach()), float(error)])
        if not np.isfinite(values).all():
            raise FloatingPointError(
                f"the forecaster diverged at step {step} ({moment.phase}): the loss is {values[0]}. "
                "Lower forecaster.rate.* or look for broken frames with `lagsplat inspect`"
            )
        return values

    def _set_rates(self, moment: TrainingMoment) -> None:
        """Set the step sizes: a half cosine for graph networks, a constant factor per step for images."""
        steps = [self.config.steps[name] for name in PHASES]
        done = sum(steps[: PHASES.index(moment.phase)]) + moment.inner
        for group in self.optimizer.param_groups:
            first, last = group["ends"]
            if moment.phase == "graph":
                group["lr"] = decay_by_cosine(moment.inner, moment.length, initial=first, final=last)
            else:
                group["lr"] = first * (last / first) ** (done / sum(steps[:-1]))

    def image_loss(self, moment: TrainingMoment, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """The loss of one image, and its mean absolute colour error."""
        config, forecaster, scene = self.config, self.forecaster, self.scene
        frame = int(rng.integers(len(self.frames)))
        truth = to_images(self.frames[frame : frame + 1])
        if moment.phase == "warm_up":
            still = torch.zeros(len(scene.place), 3)
            drawn = forecaster.draw((still[:, :2], still[:, 2:]))
        elif moment.phase == "free":
            noise = self._noise(scene.place, moment, rng)
            drawn = forecaster.draw(forecaster.shift(scene, float(frame), noise=noise))
        else:
            if moment.inner % FRESH_NEIGHBOURS == 0 or self.nearest is None:
                self.nearest = forecaster.nearest()
            noise = self._noise(self.keys.place, moment, rng) if moment.phase == "keys" else 0.0
            shift = forecaster.shift(self.keys, float(frame), noise=noise)
            drawn = forecaster.draw(self.keys.blend(self.nearest, shift))
        error = (drawn - truth).abs().mean()
        loss = config.l1 * error
        if config.ssim:
            loss = loss + config.ssim * structural_dissimilarity(drawn, truth, window=config.ssim_window)
        if moment.phase == "free":
            loss = loss + config.motion.feature_penalty * scene.feature.abs().mean()
        return loss, error.detach()

    def _noise(self, place: nn.Parameter, moment: TrainingMoment, rng: np.random.Generator) -> Tensor | float:
        """Noise on the places that the network sees; zero after the first third of a phase."""
        sigma = self.config.motion.place_noise * max(0.0, 1 - 3 * moment.inner / moment.length)
        if sigma == 0.0:
            return 0.0
        return torch.as_tensor(sigma * rng.standard_normal(tuple(place.shape)), dtype=place.dtype)

    def graph_loss(self, moment: TrainingMoment, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Mean distance of the predicted key points, and of the ends of their rotated unit vectors."""
        config, forecaster, (places, turns) = self.config.graph, self.forecaster, self.series
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
                predicted = model.wrap_angle(predicted)
            # the root's derivative at zero is not finite
            apart = (predicted - truth).unflatten(1, (-1, 2)).square().sum(-1)
            errors.append((apart + 1e-12).sqrt().mean())
        return errors[0] + errors[1], errors[0].detach()
