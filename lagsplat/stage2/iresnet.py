"""Invertible residual network: a diffeomorphism of the latent space, with its pull-back written out."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

Block = tuple[Tensor, Tensor, Tensor, Tensor]
"""Weights of one residual branch: inner (w,d), inner bias (w,), outer (d,w), outer bias (d,)."""


def contract(weight: Float[Tensor, "blocks a b"]) -> Float[Tensor, "blocks a b"]:
    """Divide each matrix by its largest singular value where that exceeds 1.

    The small Gram matrix gives the singular value exactly, which a power iteration only approaches from
    below. A matrix inside the unit ball is left alone, so that it may vanish.
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
        self, d: int, *, blocks: int, width: int, lipschitz: float, generator: torch.Generator
    ) -> None:
        super().__init__()
        draw = torch.randn(blocks, width, d, generator=generator, dtype=torch.float64)
        self.inner = nn.Parameter(draw / width**0.5)
        self.inner_bias = nn.Parameter(
            2.0 * torch.rand(blocks, width, generator=generator, dtype=torch.float64) - 1.0
        )
        self.outer = nn.Parameter(torch.zeros(blocks, d, width, dtype=torch.float64))
        self.outer_bias = nn.Parameter(torch.zeros(blocks, d, dtype=torch.float64))
        self.lipschitz = lipschitz

    def blocks(self) -> list[Block]:
        """Normalised weights of every block."""
        inner = contract(self.inner)
        outer = self.lipschitz * contract(self.outer)
        return list(zip(inner, self.inner_bias, outer, self.outer_bias, strict=True))


def push(
    x: Float[Tensor, "B d"], blocks: list[Block]
) -> tuple[Float[Tensor, "B d"], list[Float[Tensor, "B w"]]]:
    """Image of ``x`` and the hidden activations `pull` needs. No block: the identity."""
    hidden = []
    for inner, inner_bias, outer, outer_bias in blocks:
        h = torch.tanh(torch.addmm(inner_bias, x, inner.T))
        x = x + torch.addmm(outer_bias, h, outer.T)
        hidden.append(h)
    return x, hidden


def pull(
    covector: Float[Tensor, "B d"], blocks: list[Block], hidden: list[Float[Tensor, "B w"]]
) -> Float[Tensor, "B d"]:
    """Transpose of the Jacobian of `push`, applied to a covector at the image point."""
    for (inner, _, outer, _), h in zip(reversed(blocks), reversed(hidden), strict=True):
        covector = covector + ((covector @ outer) * (1.0 - h * h)) @ inner
    return covector
