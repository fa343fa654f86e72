"""The graph network that carries key points on from their last frames."""

import torch
from jaxtyping import Float
from torch import Tensor, nn


class GraphConvolution(nn.Module):
    """``A (X W) + b`` with a dense matrix ``A`` between nodes, learned freely."""

    def __init__(self, nodes: int, n_in: int, n_out: int) -> None:
        super().__init__()
        bound = n_out**-0.5
        self.weight = nn.Parameter(torch.empty(n_in, n_out).uniform_(-bound, bound))
        self.adjacency = nn.Parameter(torch.empty(nodes, nodes).uniform_(-bound, bound))
        self.bias = nn.Parameter(torch.empty(n_out).uniform_(-bound, bound))

    def forward(self, x: Float[Tensor, "B nodes n_in"]) -> Float[Tensor, "B nodes n_out"]:
        """Features after the convolution."""
        return self.adjacency @ (x @ self.weight) + self.bias


class Layer(nn.Module):
    """A graph convolution, normalised over the batch node by node and feature by feature, and a tanh."""

    def __init__(self, nodes: int, n_in: int, n_out: int) -> None:
        super().__init__()
        self.convolution = GraphConvolution(nodes, n_in, n_out)
        self.normal = nn.BatchNorm1d(nodes * n_out)

    def forward(self, x: Float[Tensor, "B nodes n_in"]) -> Float[Tensor, "B nodes n_out"]:
        """Features of the next layer, in (-1, 1)."""
        y = self.convolution(x)
        return torch.tanh(self.normal(y.flatten(1)).view_as(y))


class GraphNet(nn.Module):
    """The next value of every node from its last ``history`` ones: absolute, no skip from the last frame.

    Nothing in it contracts: carried on for long, it may come to rest, decay or orbit.

    Source: facts of the published forecaster, its graph network.
    """

    def __init__(self, nodes: int, *, history: int, hidden: int, blocks: int) -> None:
        super().__init__()
        self.first = Layer(nodes, history, hidden)
        self.blocks = nn.ModuleList(
            nn.Sequential(Layer(nodes, hidden, hidden), Layer(nodes, hidden, hidden)) for _ in range(blocks)
        )
        self.head = nn.Sequential(nn.Linear(hidden, hidden), nn.ReLU(), nn.Linear(hidden, 1))

    def forward(self, past: Float[Tensor, "B history nodes"]) -> Float[Tensor, "B nodes"]:
        """The values one frame later."""
        value = self.first(past.mT)
        for block in self.blocks:
            value = value + block(value)
        return self.head(value)[:, :, 0]
