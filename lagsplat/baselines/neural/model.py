"""A free neural differential equation, and its file."""

import os
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor, nn
from torchdiffeq import odeint

from lagsplat.io.artefact import load_artefact, save_artefact
from lagsplat.io.restore import restore

KIND, SCHEMA = "neural_ode", 1


class NeuralOde(nn.Module):
    """``dx/dt = f(x)`` with ``x`` the whitened state and its velocity, and ``f`` any network of both.

    One internal unit of time is ``time_unit_s`` seconds; velocities are per unit. Nothing dissipates, nothing
    conserves, no state is preferred, and the velocity need not even be that of the state.
    """

    def __init__(self, d: int, *, hidden: int, layers: int, method: str, time_unit_s: float) -> None:
        super().__init__()
        self.architecture = {
            "d": d,
            "hidden": hidden,
            "layers": layers,
            "method": method,
            "time_unit_s": time_unit_s,
        }
        self.d, self.method, self.time_unit_s = d, method, time_unit_s
        widths = [2 * d, *[hidden] * layers]
        self.layers = nn.ModuleList(nn.Linear(a, b, dtype=torch.float64) for a, b in pairwise(widths))
        self.head = nn.Linear(hidden, 2 * d, dtype=torch.float64)

    def forward(self, time: Tensor, state: Float[Tensor, "B n"]) -> Float[Tensor, "B n"]:
        """Rate of change of states ``(q, v)``; the time does not matter."""
        value = state
        for layer in self.layers:
            value = torch.tanh(layer(value))
        return self.head(value)

    def rollout(self, start: Float[Tensor, "B n"], *, states: int, dt_s: float) -> Float[Tensor, "N B n"]:
        """States ``(q, v)`` at ``states`` instants ``dt_s`` [s] apart, the first as given."""
        instants = torch.arange(states, dtype=torch.float64) * (dt_s / self.time_unit_s)
        return odeint(self, start, instants, method=self.method)


def carry_on(
    ode: NeuralOde,
    q0: Float64[np.ndarray, "B d"],
    v0: Float64[np.ndarray, "B d"],
    *,
    states: int,
    dt_s: float,
) -> Float64[np.ndarray, "B N d"]:
    """States of rollouts from ``q0`` and ``v0`` [1/s]; what leaves the finite numbers stays so.

    By the classical Runge-Kutta scheme, one step a frame, on plain arrays: a thousand seconds in torch would
    be minutes.
    """
    weights = [(layer.weight.detach().numpy().T, layer.bias.detach().numpy()) for layer in ode.layers]  # type: ignore[union-attr,operator]
    head = (ode.head.weight.detach().numpy().T, ode.head.bias.detach().numpy())

    def rate(x: np.ndarray) -> np.ndarray:
        for weight, bias in weights:
            x = np.tanh(x @ weight + bias)
        return x @ head[0] + head[1]

    h = dt_s / ode.time_unit_s
    x = np.concatenate([q0, v0 * ode.time_unit_s], axis=1)
    path = np.empty((states, *x.shape))
    path[0] = x
    step = _STEPS[ode.method]
    with np.errstate(all="ignore"):
        for i in range(1, states):
            x = path[i] = step(rate, x, h)
    return np.moveaxis(path[:, :, : ode.d], 0, 1)


def _rk4(rate: Any, x: np.ndarray, h: float) -> np.ndarray:
    """The three-eighths rule, which is what torchdiffeq calls rk4."""
    k1 = rate(x)
    k2 = rate(x + h / 3 * k1)
    k3 = rate(x + h * (k2 - k1 / 3))
    k4 = rate(x + h * (k1 - k2 + k3))
    return x + h / 8 * (k1 + 3 * (k2 + k3) + k4)


def _midpoint(rate: Any, x: np.ndarray, h: float) -> np.ndarray:
    return x + h * rate(x + 0.5 * h * rate(x))


_STEPS = {"rk4": _rk4, "midpoint": _midpoint}


def save_ode(path: str | os.PathLike[str], ode: NeuralOde, header: Mapping[str, Any]) -> None:
    """Write the weights and what is needed to build the same model again."""
    save_artefact(
        path, ode.state_dict(), {"kind": KIND, "schema": SCHEMA, **header, "architecture": ode.architecture}
    )


def load_ode(path: str | os.PathLike[str]) -> tuple[NeuralOde, dict[str, Any]]:
    """Read a free differential equation and its header.

    Raises:
        FileNotFoundError: nothing is at ``path``.
        ValueError: the file is none, or one of another schema.
    """
    tensors, header = load_artefact(path, kind=KIND, schema=SCHEMA)
    ode = NeuralOde(**header["architecture"])
    return restore(ode, tensors, path), header
