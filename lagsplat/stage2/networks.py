"""Networks of the law: an input-convex network, an invertible residual network, and matrix fields.

Gradients and pull-backs are forward formulas, so that training differentiates through them once instead of
twice.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import softplus

from lagsplat.array_types import Latents, Spd


class Icnn(nn.Module):
    """Functions ``g_c(u) = w_c . h2(u)``, each convex, sharing one trunk.

    ``h1 = sp(A1 u + b1)`` and ``h2 = sp(A2 u + b2 + sp(R) h1)``. Convexity needs ``w >= 0``, which
    `project` restores after an optimiser step; ``w`` starts at zero, so every ``g_c`` starts at zero and yet
    has a gradient.

    Source: Amos et al. 2017, arXiv:1609.07152.
    """

    def __init__(self, d: int, *, width: int, heads: int, generator: torch.Generator) -> None:
        super().__init__()
        bound = 1.0 / math.sqrt(d)

        def uniform(*shape: int) -> nn.Parameter:
            draw = torch.rand(*shape, generator=generator, dtype=torch.float64)
            return nn.Parameter((2.0 * draw - 1.0) * bound)

        self.first = uniform(width, d)
        self.first_bias = uniform(width)
        self.second = uniform(width, d)
        self.second_bias = uniform(width)
        # sp(-3) = 0.05: a wide layer of non-negative weights would otherwise swamp A2 u
        self.between = nn.Parameter(torch.full((width, width), -3.0, dtype=torch.float64))
        self.head = nn.Parameter(torch.zeros(heads, width, dtype=torch.float64))

    def project(self) -> None:
        """Clip the head to non-negative weights, which keep the functions convex."""
        with torch.no_grad():
            self.head.clamp_(min=0.0)

    def between_weight(self) -> Float[Tensor, "h h"]:
        """Compute the non-negative weights between the hidden layers, once per optimiser step."""
        return softplus(self.between)

    def value(self, u: Float[Tensor, "B d"]) -> Float[Tensor, "B heads"]:
        """Evaluate the functions ``g_c`` at ``u``."""
        h1 = softplus(torch.addmm(self.first_bias, u, self.first.T))
        h2 = softplus(torch.addmm(self.second_bias, u, self.second.T) + h1 @ self.between_weight().T)
        return h2 @ self.head.T

    def gradient(self, u: Latents, head: Float[Tensor, "#B h"], between: Float[Tensor, "h h"]) -> Latents:
        """Gradient in ``u`` of ``head . h2(u)``, with ``between`` from `between_weight`.

        ``head`` is one row of `head`, or per sample a non-negative combination of rows.
        """
        z1 = torch.addmm(self.first_bias, u, self.first.T)
        z2 = torch.addmm(self.second_bias, u, self.second.T) + softplus(z1) @ between.T
        g2 = torch.sigmoid(z2) * head
        g1 = (g2 @ between) * torch.sigmoid(z1)
        return g2 @ self.second + g1 @ self.first


Block = tuple[Tensor, Tensor, Tensor, Tensor]
"""Weights of one residual branch: inner (w,d), inner bias (w,), outer (d,w), outer bias (d,)."""
Hidden = list[Float[Tensor, "B w"]]
"""Activations of each branch."""


def contract_spectral_norm(weight: Float[Tensor, "blocks a b"]) -> Float[Tensor, "blocks a b"]:
    """Divide each matrix by its largest singular value where that exceeds 1.

    The Gram matrix gives this value exactly; a power iteration approaches it only from below. A matrix with a
    smaller norm is unchanged, so that it may vanish.
    """
    a, b = weight.shape[-2:]
    gram = weight @ weight.mT if a <= b else weight.mT @ weight
    largest = torch.linalg.eigvalsh(gram)[..., -1]
    return weight / largest.clamp(min=1.0).sqrt()[:, None, None]


class Diffeomorphism(nn.Module):
    """``x <- x + c W2 tanh(W1 x + b1) + b2`` over a few blocks, each branch of Lipschitz constant ``c`` < 1.

    Starts at the identity (``W2 = 0``). `blocks` normalises the weights, once per optimiser step.

    Source: Behrmann et al. 2019, arXiv:1811.00995.
    """

    def __init__(
        self, d: int, blocks: int, width: int, *, lipschitz: float, generator: torch.Generator
    ) -> None:
        super().__init__()
        inner = torch.randn(blocks, width, d, generator=generator, dtype=torch.float64)
        bias = torch.rand(blocks, width, generator=generator, dtype=torch.float64)
        self.inner = nn.Parameter(inner / width**0.5)
        self.inner_bias = nn.Parameter(2.0 * bias - 1.0)
        self.outer = nn.Parameter(torch.zeros(blocks, d, width, dtype=torch.float64))
        self.outer_bias = nn.Parameter(torch.zeros(blocks, d, dtype=torch.float64))
        self.lipschitz = lipschitz

    def blocks(self) -> list[Block]:
        """Compute the normalised weights of every block."""
        inner = contract_spectral_norm(self.inner)
        outer = self.lipschitz * contract_spectral_norm(self.outer)
        return list(zip(inner, self.inner_bias, outer, self.outer_bias, strict=True))


def push_forward(x: Latents, blocks: list[Block]) -> tuple[Latents, Hidden]:
    """Map ``x`` through the blocks; also return the hidden activations for `pull_back`."""
    hidden = []
    for inner, inner_bias, outer, outer_bias in blocks:
        h = torch.tanh(torch.addmm(inner_bias, x, inner.T))
        x = x + torch.addmm(outer_bias, h, outer.T)
        hidden.append(h)
    return x, hidden


def pull_back(covector: Latents, blocks: list[Block], hidden: Hidden) -> Latents:
    """Apply the transposed Jacobian of `push_forward` to a covector at the image point."""
    for (inner, _, outer, _), h in zip(reversed(blocks), reversed(hidden), strict=True):
        covector = covector + ((covector @ outer) * (1.0 - h * h)) @ inner
    return covector


def factor_positive(matrix: Float[Tensor, "d d"], floor: float) -> Float[Tensor, "d d"]:
    """Compute a lower-triangular ``L`` with ``L L^T + floor I`` equal to ``matrix``.

    Eigenvalues are clipped to 1.001 times the floor, so that the factor still has a gradient.
    """
    values, vectors = torch.linalg.eigh(matrix)
    clipped = (values - floor).clamp(min=1e-3 * floor)
    return torch.linalg.cholesky((vectors * clipped) @ vectors.T)


def cholesky_solve(matrix: Spd, force: Latents) -> Latents:
    """Solve ``matrix x = force`` for each sample; unlike `torch.linalg.cholesky` it never raises."""
    return torch.cholesky_solve(force[:, :, None], torch.linalg.cholesky_ex(matrix)[0])[:, :, 0]


class ConstantMatrix(nn.Module):
    """``S = L0 L0^T + floor I``, the same everywhere."""

    def __init__(self, start: Float[Tensor, "d d"], *, floor: float) -> None:
        super().__init__()
        self.factor = nn.Parameter(factor_positive(start, floor))
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
        return torch.cholesky_solve(force.T, torch.linalg.cholesky_ex(self.matrix(q[:1])[0])[0]).T


class MatrixField(nn.Module):
    """``S(q) = L0 E(q) E(q)^T L0^T + floor I``, ``E - I`` a network of two tanh layers that starts at zero.

    ``E`` is lower triangular, so that the deviation is relative to the starting matrix. Tanh saturates away
    from the data, so that velocity forces, quadratic in ``v``, cannot grow with ``q``.
    """

    mask: Tensor
    identity: Tensor

    def __init__(
        self, start: Float[Tensor, "d d"], *, floor: float, width: int, generator: torch.Generator
    ) -> None:
        super().__init__()
        d = start.shape[0]

        first = torch.randn(width, d, generator=generator, dtype=torch.float64)
        second = torch.randn(width, width, generator=generator, dtype=torch.float64)
        self.factor = nn.Parameter(factor_positive(start, floor))
        self.first = nn.Parameter(first / math.sqrt(d))
        self.first_bias = nn.Parameter(torch.zeros(width, dtype=torch.float64))
        self.second = nn.Parameter(second / math.sqrt(width))
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
        return cholesky_solve(mass, force + velocity_force)
