"""Networks that act on every pixel alike and know where it is.

Pixels are listed row by row, P = H W of them, and are the last axis but one. Their coordinates are
``(y, x)``, each from -1 to 1 between the centres of the outermost pixels: these models' own convention,
which is not the package's.
"""

from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from lagsplat.baselines.encoder import SLOPE

Places = Float[Tensor, "P 2"]


def pixel_places(height: int, width: int) -> Places:
    """The coordinates ``(y, x)`` of every pixel."""
    rows, columns = torch.linspace(-1.0, 1.0, height), torch.linspace(-1.0, 1.0, width)
    return torch.stack(torch.meshgrid(rows, columns, indexing="ij"), -1).flatten(0, 1)


class PixelNet(nn.Module):
    """A perceptron of the same weights at every pixel, fed with ``n_in`` numbers and the pixel's place."""

    def __init__(self, n_in: int, hidden: tuple[int, ...], n_out: int) -> None:
        super().__init__()
        self.n_in = n_in
        widths = (n_in + 2, *hidden, n_out)
        self.layers = nn.ModuleList(nn.Linear(before, after) for before, after in pairwise(widths))

    def forward(self, given: Float[Tensor, "B p n"], places: Places) -> Float[Tensor, "B P m"]:
        """Outputs at ``places``; ``given`` has one row a pixel, or one for all of them (p = 1)."""
        first, *rest = self.layers
        assert isinstance(first, nn.Linear)
        weight, bias = first.weight, first.bias
        # What does not depend on the pixel, or not on the image, is multiplied once.
        here = functional.linear(places, weight[:, self.n_in :], bias)
        value = functional.linear(given, weight[:, : self.n_in]) + here
        for layer in rest:
            value = layer(functional.leaky_relu(value, SLOPE))
        return value
