"""The likelihood of a law over windows of a trajectory, whose residuals are those of its rollouts.

Residuals are the encoded positions less those of the rollouts, as latents, in units of their noise, which is
autoregressive; and the gaps between the end of a window and the start of the next, in units of a coupling.
"""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from lagsplat.stage2.likelihood.guard import Guard
from lagsplat.stage2.likelihood.parameter_vector import Paths, States
from lagsplat.stage2.likelihood.prior import Prior
from lagsplat.stage2.likelihood.windows import Windows

LONGEST_MEMORY = 0.98  # of autoregressive noise, below a random walk, which would say nothing of positions


class LawParameters(Protocol):
    """The parameters of a law as one vector, and rollouts as a function of it."""

    def read(self) -> Float[Tensor, " p"]:
        """The parameters as they are."""

    def roll_out(self, theta: Float[Tensor, " p"], starts: States, windows: Windows) -> Paths:
        """States of all windows, the start included; leaves the law at ``theta``."""

    def observe(
        self, theta: Float[Tensor, " p"], x: Float[Tensor, "K n d"], near: Float[Tensor, "K n d"]
    ) -> Float[Tensor, "K n d"]:
        """Latents at positions in the coordinates of the law, first guessed; leaves the law at ``theta``."""


@dataclass(frozen=True)
class Residuals:
    """Paths of all windows, their errors, residuals of unit size, and half the sum of their squares.

    ``misfit`` counts the guard's residuals as well, ``cost`` the prior's too.
    """

    path: Paths
    latents: Float[Tensor, "K n d"]  # without the last state of a window, which is the first of the next
    error: Float[Tensor, "K n d"]  # of latents, before the noise's memory and size are taken out
    position: Float[Tensor, "K n d"]
    gap: Float[Tensor, "G s"]
    misfit: float
    cost: float


@dataclass(frozen=True)
class WindowFit:
    """Result of a fit: states at the window starts; rms residual of each coordinate and its correlation.

    ``missed`` is the larger of that and the rms gap, of the worst coordinate [whitened units].
    """

    starts: States
    rms: Float64[np.ndarray, " d"]
    memory: Float64[np.ndarray, " d"]
    cost: float
    missed: float
    steps: int


class WindowLikelihood:
    """The likelihood of a law, and what its windows leave.

    Args:
        parameters: of the law.
        windows: of the trajectory.
        noise: standard deviation of the encoded positions, one for each coordinate.
        memory: correlation of the noise from frame to frame: it is autoregressive.
        coupling: standard deviation of the gaps between windows, one for each position and velocity.
        prior: of the parameters.
        guard: keeps the map of a polynomial law invertible and its loaded stiffness positive.
    """

    def __init__(
        self,
        parameters: LawParameters,
        windows: Windows,
        *,
        noise: Float64[np.ndarray, " d"],
        memory: Float64[np.ndarray, " d"],
        coupling: Float64[np.ndarray, " s"],
        prior: Prior,
        guard: Guard | None = None,
    ) -> None:
        self.parameters, self.windows = parameters, windows
        self.prior, self.guard = prior, guard
        self.noise, self.memory = torch.from_numpy(noise), torch.from_numpy(memory)
        self.coupling = torch.from_numpy(coupling)
        self.before = np.flatnonzero(windows.linked)

    def describe(self, now: Residuals, starts: States, *, steps: int) -> WindowFit:
        """What a fit of so many ``steps`` has come to."""
        error = now.error.numpy()
        power = np.mean(error**2, axis=(0, 1)) + 1e-300
        memory = np.mean(error[:, 1:] * error[:, :-1], axis=(0, 1)) / power
        return WindowFit(
            starts, np.sqrt(power), np.clip(memory, 0.0, LONGEST_MEMORY), now.cost, self._missed(now), steps
        )

    def _with_prior(self, theta: Float[Tensor, " p"], now: Residuals) -> Residuals:
        """Residuals whose cost is that under the prior as it is."""
        prior = float(self.prior.precision @ np.square(theta.numpy() - self.prior.mean))
        cost = now.misfit + 0.5 * prior
        return replace(now, cost=cost if np.isfinite(cost) else float("inf"))

    def _missed(self, now: Residuals) -> float:
        position = now.error.square().mean((0, 1)).sqrt()
        gap = now.gap.square().mean(0).sqrt() * self.coupling if len(now.gap) else position
        return float(torch.cat([position, gap]).detach().max())

    def evaluate(self, theta: Float[Tensor, " p"], starts: States) -> Residuals:
        """Roll out all windows and measure what they miss; the cost of a divergence is infinite."""
        path = self.parameters.roll_out(theta, starts, self.windows)
        targets = self.windows.targets[:, :-1]
        latents = self.parameters.observe(theta, path[:, :-1, : len(self.noise)], targets)
        error = latents - targets
        position = self._whiten(error[..., None])[..., 0]
        gap = (starts[self.before + 1] - path[self.before, -1]) / self.coupling
        misfit = position.square().sum() + gap.square().sum()
        if self.guard is not None:
            misfit = misfit + self.guard.measure(theta)[0].square().sum()
        residuals = Residuals(path, latents, error, position, gap, 0.5 * float(misfit.detach()), float("inf"))
        return self._with_prior(theta, residuals)

    def _whiten(self, residual: Float[Tensor, "K n d k"]) -> Float[Tensor, "K n d k"]:
        """Residuals as independent ones of unit size, window by window."""
        fresh = self.noise * (1.0 - self.memory**2).sqrt()
        sizes = fresh.repeat(residual.shape[1], 1)
        sizes[0] = self.noise
        whitened = residual / sizes[:, :, None]
        whitened[:, 1:].addcmul_(residual[:, :-1], -(self.memory / fresh)[:, None])
        return whitened
