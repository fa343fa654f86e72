"""A neural ordinary differential equation, its file, and its training on windows of the training part."""

import math
from collections.abc import Mapping
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Float64
from scipy.interpolate import CubicSpline
from torch import Tensor, nn
from torchdiffeq import odeint

from lagsplat.baselines.config import OdeConfig
from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.io.files.artifact import StrPath, load_artifact, restore_module, save_artifact
from lagsplat.io.files.checkpoint import load_training_state, save_training_state
from lagsplat.stage1.training import run_training

KIND, SCHEMA = "neural_ode", 1
EARLY = 0.25  # share of the full window length at the start of the training


class OdeCurvePoint(NamedTuple):
    """Mean loss since the previous point, and total seconds of training."""

    step: int
    loss: float
    seconds: float


class NeuralOde(nn.Module):
    """``dx/dt = f(x)`` with ``x`` the whitened state and its velocity, and ``f`` any network of both.

    One internal unit of time is ``time_unit_s`` seconds; velocities are per unit. Nothing enforces
    dissipation, conservation or an equilibrium, nor that the velocity is the derivative of the state.
    """

    def __init__(self, d: int, *, hidden: int, layers: int, method: str, time_unit_s: float) -> None:
        super().__init__()
        sizes = {"d": d, "hidden": hidden, "layers": layers}
        self.architecture = {**sizes, "method": method, "time_unit_s": time_unit_s}
        self.d, self.method, self.time_unit_s = d, method, time_unit_s
        widths = [2 * d, *[hidden] * layers]
        self.layers = nn.ModuleList(nn.Linear(a, b, dtype=torch.float64) for a, b in pairwise(widths))
        self.head = nn.Linear(hidden, 2 * d, dtype=torch.float64)

    def forward(self, time: Tensor, state: Float[Tensor, "B n"]) -> Float[Tensor, "B n"]:
        """Rate of change of states ``(q, v)``, independent of time."""
        value = state
        for layer in self.layers:
            value = torch.tanh(layer(value))
        return self.head(value)

    def rollout(self, start: Float[Tensor, "B n"], *, states: int, dt_s: float) -> Float[Tensor, "N B n"]:
        """States ``(q, v)`` at ``states`` instants ``dt_s`` [s] apart, the first as given."""
        instants = torch.arange(states, dtype=torch.float64) * (dt_s / self.time_unit_s)
        return odeint(self, start, instants, method=self.method)


def fit_ode(
    train: EncodedTrajectory,
    metric: Float64[np.ndarray, "d d"],
    config: OdeConfig,
    *,
    seed: int,
    checkpoint: Path | None = None,
    identity: str = "",
) -> tuple[NeuralOde, list[OdeCurvePoint]]:
    """Fit ``f`` so that rollouts from encoded states follow the encoded motion.

    The training part is smoothed and its inputs are ignored. Windows grow from a quarter of
    ``config.periods`` natural periods to all of it. The loss is the squared distance in the metric, of the
    state and, in natural units, of the velocity. Unevenly spaced frames are interpolated first.
    ``identity`` identifies the run in the file ``checkpoint``.

    Raises:
        ValueError: no clip is as long as a window.
        FloatingPointError: the loss stops being finite.

    Source: Chen et al. 2018, arXiv:1806.07366.
    """
    unit_s = _time_unit(train, metric)
    clips = [_series(train, ends, unit_s) for ends in train.segments]
    longest = max(len(clip) for clip in clips)
    window = min(max(round(config.periods * 2 * np.pi * unit_s / train.dt_s) + 1, 4), longest)
    torch.manual_seed(seed)
    ode = NeuralOde(
        train.latents.shape[1],
        hidden=config.hidden,
        layers=config.layers,
        method=config.method,
        time_unit_s=unit_s,
    )
    optimizer = torch.optim.Adam(ode.parameters(), lr=config.rate)
    weight = torch.from_numpy(np.kron(np.eye(2), metric))
    curve = load_training_state(checkpoint, ode, optimizer, OdeCurvePoint, identity=identity)

    def take_step(step: int) -> np.ndarray:
        wave = 0.5 * (1 + math.cos(math.pi * step / config.steps))
        for group in optimizer.param_groups:
            group["lr"] = config.rate * (config.final_fraction + (1 - config.final_fraction) * wave)
        # windows grow over the first half of the training
        share = min(1.0, EARLY + (1 - EARLY) * 2 * step / config.steps)
        length = max(4, min(window, math.ceil(share * window)))
        batch = _windows(clips, length, config.batch, np.random.default_rng([seed, step]))
        optimizer.zero_grad(set_to_none=True)
        missed = ode.rollout(batch[0], states=len(batch), dt_s=train.dt_s) - batch
        loss = torch.einsum("nbi,ij,nbj->nb", missed, weight, missed).mean()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(ode.parameters(), config.gradient_clip)
        optimizer.step()
        value = float(loss.detach())
        if not math.isfinite(value):
            raise FloatingPointError(
                f"the neural ODE lost its footing at step {step}: the loss is {value}. Lower ode.rate or "
                "ode.periods"
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


def _series(train: EncodedTrajectory, ends: tuple[int, int], unit_s: float) -> torch.Tensor:
    """States and velocities of one clip, evenly spaced, velocities per internal unit of time."""
    time_s = train.time_s[slice(*ends)]
    if len(time_s) < 4:
        raise ValueError(
            f"a clip of {len(time_s)} training frames: a law of motion needs four; give longer clips"
        )
    path = CubicSpline(time_s, train.latents[slice(*ends)])
    n = int((time_s[-1] - time_s[0]) / train.dt_s + 1e-6) + 1
    at = np.minimum(time_s[0] + train.dt_s * np.arange(n), time_s[-1])
    return torch.from_numpy(np.concatenate([path(at), path(at, 1) * unit_s], axis=1))


def _windows(clips: list[torch.Tensor], length: int, batch: int, rng: np.random.Generator) -> torch.Tensor:
    """Random windows from all clips that are long enough, (N, B, 2d)."""
    fitting = [clip for clip in clips if len(clip) >= length]
    room = np.array([len(clip) - length + 1 for clip in fitting])
    picked = rng.integers(room.sum(), size=batch)
    which = np.searchsorted(np.cumsum(room), picked, side="right")
    starts = picked - np.concatenate([[0], np.cumsum(room)])[which]
    return torch.stack([fitting[c][s : s + length] for c, s in zip(which, starts, strict=True)], dim=1)


def continue_rollout(
    ode: NeuralOde,
    q0: Float64[np.ndarray, "B d"],
    v0: Float64[np.ndarray, "B d"],
    *,
    states: int,
    dt_s: float,
) -> Float64[np.ndarray, "B N d"]:
    """States at ``states`` instants, ``dt_s`` [s] apart, from ``q0`` and ``v0`` [1/s], one step a frame.

    Divergence stays non-finite. NumPy, because a thousand seconds in torch would take minutes.
    """
    layers = (*ode.layers, ode.head)
    *hidden, head = ((layer.weight.detach().numpy().T, layer.bias.detach().numpy()) for layer in layers)

    def rate(x: np.ndarray) -> np.ndarray:
        for weight, bias in hidden:
            x = np.tanh(x @ weight + bias)
        return x @ head[0] + head[1]

    h = dt_s / ode.time_unit_s

    def step(x: np.ndarray) -> np.ndarray:
        k1 = rate(x)
        if ode.method == "midpoint":
            return x + h * rate(x + 0.5 * h * k1)
        # the three-eighths rule, which is what torchdiffeq calls rk4
        k2 = rate(x + h / 3 * k1)
        k3 = rate(x + h * (k2 - k1 / 3))
        k4 = rate(x + h * (k1 - k2 + k3))
        return x + h / 8 * (k1 + 3 * (k2 + k3) + k4)

    x = np.concatenate([q0, v0 * ode.time_unit_s], axis=1)
    path = np.empty((states, *x.shape))
    path[0] = x
    with np.errstate(all="ignore"):
        for i in range(1, states):
            path[i] = step(path[i - 1])
    return np.moveaxis(path[:, :, : ode.d], 0, 1)


def save_ode(path: StrPath, ode: NeuralOde, header: Mapping[str, Any]) -> None:
    """Write the weights and the architecture."""
    header = {"kind": KIND, "schema": SCHEMA, **header, "architecture": ode.architecture}
    save_artifact(path, ode.state_dict(), header)


def load_ode(path: StrPath) -> tuple[NeuralOde, dict[str, Any]]:
    """Read a neural ODE and its header; errors as `lagsplat.io.files.artifact.load_artifact`."""
    tensors, header = load_artifact(path, kind=KIND, schema=SCHEMA)
    ode = NeuralOde(**header["architecture"])
    return restore_module(ode, tensors, path), header
