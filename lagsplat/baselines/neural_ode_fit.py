"""Train a neural ordinary differential equation on windows of the training part."""

import math
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float64
from scipy.interpolate import CubicSpline
from torch import Tensor

from lagsplat.baselines.config import OdeConfig
from lagsplat.baselines.neural_ode import STRUCTURES, LatentOde
from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.io.files.checkpoint import load_training_state, save_training_state
from lagsplat.stage1.training import decay_by_cosine, run_training

EARLY = 0.25  # share of the full window length at the start of the training


class OdeCurvePoint(NamedTuple):
    """Mean loss since the previous point, and total seconds of training."""

    step: int
    loss: float
    seconds: float


def fit_ode(
    train: EncodedTrajectory,
    metric: Float64[np.ndarray, "d d"],
    config: OdeConfig,
    *,
    seed: int,
    checkpoint: Path | None = None,
    identity: str = "",
) -> tuple[LatentOde, list[OdeCurvePoint]]:
    """Fit an equation so that rollouts from encoded states follow the encoded motion under its inputs.

    The training part is smoothed. Windows grow from a quarter of ``config.periods`` natural periods to all
    of it. The loss is the squared distance in the metric, of the state and, in natural units, of the
    velocity. Unevenly spaced frames are interpolated first. ``identity`` identifies the run in the file
    ``checkpoint``.

    Raises:
        ValueError: no clip is as long as a window.
        FloatingPointError: the loss stops being finite.
    """
    unit_s = _time_unit(train, metric)
    clips = [_series(train, ends, unit_s) for ends in train.segments]
    longest = max(len(clip) for clip in clips)
    d = train.latents.shape[1]
    window = min(max(round(config.periods * 2 * np.pi * unit_s / train.dt_s) + 1, 4), longest)
    torch.manual_seed(seed)
    ode = _make_ode(train, config, unit_s)
    optimizer = torch.optim.Adam(ode.parameters(), lr=config.rate)
    weight = torch.from_numpy(np.kron(np.eye(2), metric))
    instants_s = train.dt_s * torch.arange(window, dtype=torch.float64)
    curve = load_training_state(checkpoint, ode, optimizer, OdeCurvePoint, identity=identity)

    def take_step(step: int) -> np.ndarray:
        for group in optimizer.param_groups:
            group["lr"] = config.rate * decay_by_cosine(step, config.steps, final=config.final_fraction)
        # windows grow over the first half of the training
        share = min(1.0, EARLY + (1 - EARLY) * 2 * step / config.steps)
        length = max(4, min(window, math.ceil(share * window)))
        batch = _windows(clips, length, config.batch, np.random.default_rng([seed, step]))
        optimizer.zero_grad(set_to_none=True)
        states, inputs = batch.split([2 * d, batch.shape[2] - 2 * d], dim=2)
        missed = ode.rollout(states[0], inputs, instants_s[: len(batch)]) - states
        loss = torch.einsum("nbi,ij,nbj->nb", missed, weight, missed).mean()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(ode.parameters(), config.gradient_clip)
        optimizer.step()
        value = float(loss.detach())
        if not math.isfinite(value):
            raise FloatingPointError(
                f"the neural ODE diverged at step {step}: the loss is {value}. Lower ode.rate or ode.periods"
            )
        return np.array([value])

    run_training(
        take_step,
        curve,
        OdeCurvePoint,
        n_steps=config.steps,
        n_terms=1,
        title="neural ODE",
        save=partial(save_training_state, checkpoint, ode, optimizer, curve, identity=identity),
        save_every_s=config.checkpoint_every_s,
        ends=[config.steps],
    )
    return ode.eval(), curve


def _make_ode(train: EncodedTrajectory, config: OdeConfig, unit_s: float) -> LatentOde:
    ode = STRUCTURES[config.structure](
        train.latents.shape[1],
        train.inputs.shape[1],
        hidden=config.hidden,
        layers=config.layers,
        method=config.method,
        time_unit_s=unit_s,
    )
    ode.normalize_by(train.inputs)
    return ode


def _time_unit(train: EncodedTrajectory, metric: np.ndarray) -> float:
    """Ratio of the rms velocity to the rms acceleration [s]: about a natural period over 2 pi."""
    squares = np.zeros(2)
    for start, stop in train.segments:
        path = CubicSpline(train.time_s[start:stop], train.latents[start:stop])
        inner = train.time_s[start + 1 : stop - 1]
        for order in (1, 2):
            slope = path(inner, order)
            squares[order - 1] += np.einsum("ti,ij,tj->", slope, metric, slope)
    return float(np.sqrt(squares[0] / squares[1]))


def _series(train: EncodedTrajectory, ends: tuple[int, int], unit_s: float) -> Tensor:
    """States, velocities and inputs of one clip, evenly spaced, velocities per internal unit of time."""
    time_s = train.time_s[slice(*ends)]
    if len(time_s) < 4:
        raise ValueError(
            f"a clip of {len(time_s)} training frames: a law of motion needs four; give longer clips"
        )
    path = CubicSpline(time_s, train.latents[slice(*ends)])
    n = int((time_s[-1] - time_s[0]) / train.dt_s + 1e-6) + 1
    at = np.minimum(time_s[0] + train.dt_s * np.arange(n), time_s[-1])
    inputs = [np.interp(at, time_s, column)[:, None] for column in train.inputs[slice(*ends)].T]
    return torch.from_numpy(np.concatenate([path(at), path(at, 1) * unit_s, *inputs], axis=1))


def _windows(clips: list[Tensor], length: int, batch: int, rng: np.random.Generator) -> Tensor:
    """Random windows from all clips that are long enough, (N, B, n)."""
    fitting = [clip for clip in clips if len(clip) >= length]
    room = np.array([len(clip) - length + 1 for clip in fitting])
    picked = rng.integers(room.sum(), size=batch)
    which = np.searchsorted(np.cumsum(room), picked, side="right")
    starts = picked - np.concatenate([[0], np.cumsum(room)])[which]
    return torch.stack([fitting[c][s : s + length] for c, s in zip(which, starts, strict=True)], dim=1)
