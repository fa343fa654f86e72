"""Symmetric positive definite matrices over the latent space, and the inertia terms they produce.

A field is ``S(q) = L0 E(q) E(q)^T L0^T + floor I`` with ``E = I + D(q)`` lower triangular and ``D`` a network
that starts at zero: the deviation is relative to the starting matrix, whatever its scale.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn

from lagsplat.shapes import Latents, Spd


def factor_above(matrix: Float[Tensor, "d d"], floor: float) -> Float[Tensor, "d d"]:
    """Lower-triangular ``L`` with ``L L^T + floor I`` equal to ``matrix``, eigenvalues clipped to the floor.

    An eigenvalue at or below the floor keeps a thousandth of it above, so that its factor can still move.
    """
    values, vectors = torch.linalg.eigh(matrix)
    lifted = (values - floor).clamp(min=1e-3 * floor)
    return torch.linalg.cholesky((vectors * lifted) @ vectors.T)


def cholesky(matrix: Float[Tensor, "*B d d"]) -> Float[Tensor, "*B d d"]:
    """Lower Cholesky factor, without the exception that a non-finite rollout would raise."""
    return torch.linalg.cholesky_ex(matrix)[0]


def solve(matrix: Spd, force: Latents) -> Latents:
    """``matrix^-1 force``, sample by sample."""
    return torch.cholesky_solve(force[:, :, None], cholesky(matrix))[:, :, 0]


class ConstantMatrix(nn.Module):
    """``S = L0 L0^T + floor I``, the same everywhere."""

    def __init__(self, start: Float[Tensor, "d d"], *, floor: float) -> None:
        super().__init__()
        self.factor = nn.Parameter(factor_above(start, floor))
        self.floor = floor

    def matrix(self, q: Latents) -> Spd:
        """The matrix at ``q``."""
        lower = torch.tril(self.factor)
        value = lower @ lower.T + self.floor * torch.eye(q.shape[1], dtype=q.dtype)
        return value.expand(q.shape[0], -1, -1)

    def product(self, q: Latents, v: Latents) -> Latents:
        """``S(q) v``."""
        lower = torch.tril(self.factor)
        return (v @ lower) @ lower.T + self.floor * v

    def accelerate(self, q: Latents, v: Latents, force: Latents) -> Latents:
        """``S^-1 (force + velocity forces)``; a constant mass has no velocity forces."""
        return torch.cholesky_solve(force.T, cholesky(self.matrix(q[:1])[0])).T


class MatrixField(nn.Module):
    """``S(q) = L0 E(q) E(q)^T L0^T + floor I``, ``E - I`` a network of two tanh layers that starts at zero.

    Tanh saturates away from the data, so that velocity forces, quadratic in ``v``, cannot grow with ``q``.
    """

    mask: Tensor
    identity: Tensor

    def __init__(
        self, start: Float[Tensor, "d d"], *, floor: float, width: int, generator: torch.Generator
    ) -> None:
        super().__init__()
        d = start.shape[0]

        def normal(rows: int, columns: int) -> nn.Parameter:
            draw = torch.randn(rows, columns, generator=generator, dtype=torch.float64)
            return nn.Parameter(draw / math.sqrt(columns))

        self.factor = nn.Parameter(factor_above(start, floor))
        self.first = normal(width, d)
        self.first_bias = nn.Parameter(torch.zeros(width, dtype=torch.float64))
        self.second = normal(width, width)
        self.second_bias = nn.Parameter(torch.zeros(width, dtype=torch.float64))
        self.third = nn.Parameter(torch.zeros(d * d, width, dtype=torch.float64))
        self.register_buffer("mask", torch.tril(torch.ones(d, d, dtype=torch.float64)), persistent=False)
        self.register_buffer("identity", torch.eye(d, dtype=torch.float64), persistent=False)
        self.floor = floor

    def _hidden(self, q: Latents) -> tuple[Tensor, Tensor]:
        h1 = torch.tanh(torch.addmm(self.first_bias, q, self.first.T))
        return h1, torch.tanh(torch.addmm(self.second_bias, h1, self.second.T))

    def _lower(self, h: Tensor) -> Spd:
        d = self.mask.shape[0]
        return (h @ self.third.T).view(-1, d, d) * self.mask

    def matrix(self, q: Latents) -> Spd:
        """The matrix at ``q``."""
        whole = torch.tril(self.factor) @ (self.identity + self._lower(self._hidden(q)[1]))
        return whole @ whole.mT + self.floor * self.identity

    def product(self, q: Latents, v: Latents) -> Latents:
        """``S(q) v``."""
        lower = torch.tril(self.factor)
        e = self.identity + self._lower(self._hidden(q)[1])
        y = (v @ lower)[:, None, :] @ e
        return (y @ e.mT)[:, 0] @ lower.T + self.floor * v

    def inertia(self, q: Latents, v: Latents) -> tuple[Spd, Latents]:
        """``S`` and the velocity forces ``grad_q (v.S v / 2) - (dS/dt) v``.

        With ``y = L0^T v`` and ``p = E^T y`` the energy is ``|p|^2 / 2``: its gradient is one reverse sweep
        of the network from ``y p^T``, and ``dE/dt`` one forward sweep along ``v``.
        """
        lower = torch.tril(self.factor)
        h1, h2 = self._hidden(q)
        s1, s2 = 1.0 - h1 * h1, 1.0 - h2 * h2
        e = self.identity + self._lower(h2)
        y = (v @ lower)[:, :, None]
        p = e.mT @ y
        sweep = ((((v @ self.first.T) * s1) @ self.second.T) * s2) @ self.third.T
        rate = sweep.view_as(e) * self.mask
        change = (rate @ p + e @ (rate.mT @ y))[:, :, 0] @ lower.T
        back = ((y @ p.mT) * self.mask).flatten(1) @ self.third
        gradient = (((back * s2) @ self.second) * s1) @ self.first
        whole = lower @ e
        return whole @ whole.mT + self.floor * self.identity, gradient - change

    def accelerate(self, q: Latents, v: Latents, force: Latents) -> Latents:
        """``S^-1 (force + velocity forces)``."""
        mass, velocity_force = self.inertia(q, v)
        return solve(mass, force + velocity_force)
