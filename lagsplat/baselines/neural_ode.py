"""Neural ordinary differential equations in the state, its velocity and the inputs, and their file.

One kind knows no mechanics, the other is Hamiltonian with dissipation.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor, nn
from torchdiffeq import odeint

from lagsplat.io.files.artifact import StrPath, load_artifact, restore_module, save_artifact

KIND, SCHEMA = "neural_ode", 2
LEAST_INVERSE_MASS = 0.1  # keeps the mass of `HamiltonianOde` bounded

Batch = Float[Tensor, "B n"]
Inputs = Float[Tensor, "B n_u"]


def make_perceptron(inputs: int, outputs: int, *, hidden: int, layers: int) -> nn.Sequential:
    """A network of ``layers`` hidden layers of width ``hidden`` with tanh, in float64."""
    widths = [inputs, *[hidden] * layers]
    body = [layer for a, b in pairwise(widths) for layer in (nn.Linear(a, b, dtype=torch.float64), nn.Tanh())]
    return nn.Sequential(*body, nn.Linear(hidden, outputs, dtype=torch.float64))


class LatentOde(nn.Module, ABC):
    """A differential equation of the whitened state ``q`` and its velocity ``v``, driven by inputs.

    One internal unit of time is ``time_unit_s`` seconds; velocities are per unit. ``d`` and ``n_u`` count
    coordinates and inputs; ``method`` is one of torchdiffeq's, one step between two instants.
    """

    input_mean: Tensor
    input_spread: Tensor

    def __init__(
        self, d: int, n_u: int, *, hidden: int, layers: int, method: str, time_unit_s: float
    ) -> None:
        super().__init__()
        sizes = {"d": d, "n_u": n_u, "hidden": hidden, "layers": layers}
        self.architecture = {**sizes, "method": method, "time_unit_s": time_unit_s}
        self.d, self.n_u, self.method, self.time_unit_s = d, n_u, method, time_unit_s
        self.register_buffer("input_mean", torch.zeros(n_u, dtype=torch.float64))
        self.register_buffer("input_spread", torch.ones(n_u, dtype=torch.float64))

    def normalize_by(self, inputs: Float64[np.ndarray, "T n_u"]) -> None:
        """Measure the mean and the standard deviation of inputs, by which all are normalised from then on."""
        self.input_mean.copy_(torch.from_numpy(inputs.mean(axis=0)))
        spread = inputs.std(axis=0)
        self.input_spread.copy_(torch.from_numpy(np.where(spread > 0, spread, 1.0)))

    @property
    def structure(self) -> str:
        """Its name in `STRUCTURES`."""
        return next(name for name, kind in STRUCTURES.items() if isinstance(self, kind))

    @abstractmethod
    def rate(self, state: Batch, inputs: Inputs) -> Batch:
        """Rate of change of the integrated state."""

    def enter(self, state: Batch) -> Batch:
        """The integrated state of ``(q, v)``."""
        return state

    def leave(self, state: Float[Tensor, "N B n"]) -> Float[Tensor, "N B n"]:
        """The states ``(q, v)`` of integrated ones."""
        return state

    def rollout(
        self, start: Batch, inputs: Float[Tensor, "N B n_u"], instants_s: Float[Tensor, " N"]
    ) -> Float[Tensor, "N B n"]:
        """States ``(q, v)`` at the instants [s], the first as given; inputs in between are linear in time."""
        instants = instants_s / self.time_unit_s
        driven = (inputs - self.input_mean) / self.input_spread

        def rate(time: Tensor, state: Tensor) -> Tensor:
            left = int(torch.searchsorted(instants, time, right=True).clamp(1, len(instants) - 1)) - 1
            share = (time - instants[left]) / (instants[left + 1] - instants[left])
            return self.rate(state, torch.lerp(driven[left], driven[left + 1], share))

        return self.leave(odeint(rate, self.enter(start), instants, method=self.method))


class NeuralOde(LatentOde):
    """``dx/dt = f(x, u)`` with ``x`` the state and its velocity, and ``f`` any network of both.

    Nothing enforces dissipation, conservation or an equilibrium, nor that the velocity is the derivative of
    the state. Source: Chen et al. 2018, arXiv:1806.07366.
    """

    def __init__(self, d: int, n_u: int, **settings: Any) -> None:
        super().__init__(d, n_u, **settings)
        sizes = {"hidden": settings["hidden"], "layers": settings["layers"]}
        self.network = make_perceptron(2 * d + n_u, 2 * d, **sizes)

    def rate(self, state: Batch, inputs: Inputs) -> Batch:
        """Whatever the network says."""
        return self.network(torch.cat([state, inputs], dim=1))


class HamiltonianOde(LatentOde):
    """``dq/dt = H_p``, ``dp/dt = -H_q - D(q) H_p + g(q) u`` with ``H = p^T M(q)^-1 p / 2 + V(q)``.

    A network gives ``V``, ``g`` and the Cholesky factors of ``M^-1`` and ``D``, so without inputs the energy
    never rises. Source: Zhong, Dey, Chakraborty 2020, Dissipative SymODEN, arXiv:2002.08860.
    """

    places: Tensor

    def __init__(self, d: int, n_u: int, **settings: Any) -> None:
        super().__init__(d, n_u, **settings)
        corner = d * (d + 1) // 2
        self.parts = (1, corner, corner, d * n_u)
        sizes = {"hidden": settings["hidden"], "layers": settings["layers"]}
        self.network = make_perceptron(d, sum(self.parts), **sizes)
        places = torch.zeros(corner, d, d, dtype=torch.float64)
        places[torch.arange(corner), *torch.tril_indices(d, d)] = 1.0
        self.register_buffer("places", places.flatten(1), persistent=False)

    def _split(self, q: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Potential, the factors of the inverse mass and of the damping, and the gains of the inputs."""
        potential, mass, damping, gain = self.network(q).split(self.parts, dim=1)
        square = (len(q), self.d, self.d)
        mass, damping = ((corner @ self.places).view(square) for corner in (mass, damping))
        return potential[:, 0], mass, damping, gain.view(len(q), self.d, self.n_u)

    def enter(self, state: Batch) -> Batch:
        """Positions and momenta, of positions and velocities."""
        q, v = state.split(self.d, dim=1)
        factor = self._split(q)[1]
        inverse_mass = factor @ factor.mT + LEAST_INVERSE_MASS * torch.eye(self.d, dtype=q.dtype)
        return torch.cat([q, torch.linalg.solve(inverse_mass, v)], dim=1)

    def leave(self, state: Float[Tensor, "N B n"]) -> Float[Tensor, "N B n"]:
        """Positions and velocities, of positions and momenta."""
        q, p = state.flatten(0, 1).split(self.d, dim=1)
        return torch.cat([q, apply_inverse_mass(self._split(q)[1], p)], dim=1).view_as(state)

    def measure_energy(self, state: Batch) -> Float[Tensor, " B"]:
        """Kinetic and potential energy of positions and momenta, in internal units."""
        q, p = state.split(self.d, dim=1)
        potential, mass, *_ = self._split(q)
        return 0.5 * (p * apply_inverse_mass(mass, p)).sum(1) + potential

    def rate(self, state: Batch, inputs: Inputs) -> Batch:
        """Hamilton's equations with damping and actuation."""
        training = torch.is_grad_enabled()
        with torch.enable_grad():
            q, p = state.split(self.d, dim=1)
            q = q if q.requires_grad else q.detach().requires_grad_()
            potential, mass, damping, gain = self._split(q)
            v = apply_inverse_mass(mass, p)
            energy = 0.5 * (p * v).sum() + potential.sum()
            (slope,) = torch.autograd.grad(energy, q, create_graph=training)
        drag = (damping @ (damping.mT @ v[..., None]))[..., 0]
        force = (gain @ inputs[..., None])[..., 0] - slope - drag
        rates = torch.cat([v, force], dim=1)
        return rates if training else rates.detach()


def apply_inverse_mass(factor: Float[Tensor, "B d d"], p: Float[Tensor, "B d"]) -> Float[Tensor, "B d"]:
    """Velocities of momenta, by the Cholesky factor of the inverse mass."""
    return (factor @ (factor.mT @ p[..., None]))[..., 0] + LEAST_INVERSE_MASS * p


STRUCTURES: dict[str, type[LatentOde]] = {"none": NeuralOde, "hamiltonian": HamiltonianOde}
"""What an equation knows of mechanics, by the name in ``ode.structure``."""


def roll_out_ode(
    ode: LatentOde,
    q0: Float64[np.ndarray, "B d"],
    v0: Float64[np.ndarray, "B d"],
    inputs: Float64[np.ndarray, "B N n_u"],
    steps_s: float | Float64[np.ndarray, "B M"],
) -> Float64[np.ndarray, "B N d"]:
    """States from ``q0`` and ``v0`` [1/s] on; ``steps_s`` [s] is one step for all, or those of each window.

    Divergence stays non-finite.
    """
    start = torch.from_numpy(np.concatenate([q0, v0 * ode.time_unit_s], axis=1))
    driven = torch.from_numpy(np.moveaxis(inputs, 1, 0))
    with torch.no_grad():
        if np.ndim(steps_s) == 0:
            instants_s = float(steps_s) * torch.arange(len(driven), dtype=torch.float64)
            path = ode.rollout(start, driven, instants_s)
        else:
            instants = np.pad(np.cumsum(steps_s, axis=1), ((0, 0), (1, 0)))
            path = torch.cat(
                [
                    ode.rollout(start[one], driven[:, one], torch.from_numpy(instants[one.start]))
                    for one in (slice(n, n + 1) for n in range(len(start)))
                ],
                dim=1,
            )
    return np.moveaxis(path[..., : ode.d].numpy(), 0, 1)


def save_ode(path: StrPath, ode: LatentOde, header: Mapping[str, Any]) -> None:
    """Write the weights, the architecture and the structure."""
    made_of = {"structure": ode.structure, "architecture": ode.architecture}
    save_artifact(path, ode.state_dict(), {"kind": KIND, "schema": SCHEMA, **header, **made_of})


def load_ode(path: StrPath) -> tuple[LatentOde, dict[str, Any]]:
    """Read a neural ODE and its header; errors as `lagsplat.io.files.artifact.load_artifact`."""
    tensors, header = load_artifact(path, kind=KIND, schema=SCHEMA)
    ode = STRUCTURES[header["structure"]](**header["architecture"])
    return restore_module(ode, tensors, path), header
