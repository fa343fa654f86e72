"""Input-convex network of two hidden layers, with its gradient written out.

The gradient is a forward formula, so that training differentiates through it once instead of twice.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import softplus


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
        """Put the head back on the non-negative orthant, where the functions are convex."""
        with torch.no_grad():
            self.head.clamp_(min=0.0)

    def between_weight(self) -> Float[Tensor, "h h"]:
        """Non-negative weight between the hidden layers; computed once per optimiser step."""
        return softplus(self.between)

    def value(self, u: Float[Tensor, "B d"]) -> Float[Tensor, "B heads"]:
        """The functions ``g_c`` at ``u``."""
        h1 = softplus(torch.addmm(self.first_bias, u, self.first.T))
        h2 = softplus(torch.addmm(self.second_bias, u, self.second.T) + h1 @ self.between_weight().T)
        return h2 @ self.head.T

    def gradient(
        self, u: Float[Tensor, "B d"], head: Float[Tensor, "#B h"], between: Float[Tensor, "h h"]
    ) -> Float[Tensor, "B d"]:
        """Gradient in ``u`` of ``head . h2(u)``, with ``between`` from `between_weight`.

        ``head`` is one row of `head`, or per sample a non-negative combination of rows.
        """
        z1 = torch.addmm(self.first_bias, u, self.first.T)
        z2 = torch.addmm(self.second_bias, u, self.second.T) + softplus(z1) @ between.T
        g2 = torch.sigmoid(z2) * head
        g1 = (g2 @ between) * torch.sigmoid(z1)
        return g2 @ self.second + g1 @ self.first
