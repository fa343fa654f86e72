"""Where things go: a network of what they are, where and when; and key points that others follow."""

from itertools import pairwise

import torch
from jaxtyping import Float, Int64
from sklearn.cluster import KMeans
from torch import Tensor, nn

Shift = tuple[Float[Tensor, "_ 2"], Float[Tensor, "_ 1"]]
"""Displacements [half widths] and turns [rad]."""


def waves(value: Float[Tensor, "N m"], octaves: int) -> Float[Tensor, "N w"]:
    """Sines and cosines of ``2^k value`` for ``octaves`` values of k; the value itself is not among them."""
    scaled = (value[:, :, None] * 2.0 ** torch.arange(octaves, device=value.device)).flatten(1)
    return torch.cat((scaled.sin(), scaled.cos()), dim=1)


class MotionNet(nn.Module):
    """Displacement and turn from a feature, a place and a time; it starts without any motion.

    Source: facts of the published forecaster, its deformation network in two dimensions.
    """

    def __init__(self, feature: int, *, octaves: int, hidden: int, layers: int) -> None:
        super().__init__()
        self.octaves = octaves
        widths = [feature + 6 * octaves, *[hidden] * layers]
        self.layers = nn.ModuleList(nn.Linear(before, after) for before, after in pairwise(widths))
        self.head = nn.Linear(hidden, 3)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)

    def forward(self, feature: Float[Tensor, "N f"], place: Float[Tensor, "N 2"], time: float) -> Shift:
        """Displacement and turn at ``time``, which runs from 0 to 1 over the clip."""
        when = waves(place.new_full((1, 1), time), self.octaves).expand(len(place), -1)
        value = torch.cat((feature, waves(place, self.octaves), when), dim=1)
        for layer in self.layers:
            value = torch.relu(layer(value))
        moved = self.head(value)
        return moved[:, :2], moved[:, 2:]


class KeyPoints(nn.Module):
    """``K`` points that the motion network moves, and how much each Gaussian follows each of them.

    A Gaussian follows its nearest points in the joint space of place and feature, shifted by one blend of
    their displacements and turned by another. A logit for every pair stands in place of the published hash
    grid: pairs that are no neighbours do not count.
    """

    def __init__(self, n: int, k: int, feature: int, *, neighbours: int, feature_weight: float) -> None:
        super().__init__()
        self.neighbours, self.feature_weight = neighbours, feature_weight
        self.place = nn.Parameter(torch.zeros(k, 2))
        self.feature = nn.Parameter(torch.zeros(k, feature))
        self.blend_logit = nn.Parameter(torch.zeros(n, k, 2))

    @torch.no_grad()
    def gather(self, place: Float[Tensor, "N 2"], feature: Float[Tensor, "N f"], *, seed: int) -> None:
        """Put the points where Gaussians that move alike are, by k-means on place and feature."""
        joint = torch.cat((place, feature), 1).double().numpy()
        found = KMeans(len(self.place), n_init=1, random_state=seed).fit(joint)
        centres = torch.as_tensor(found.cluster_centers_).to(self.place)
        self.place.copy_(centres[:, :2])
        self.feature.copy_(centres[:, 2:])
        apart = self.distances(place, feature)
        spread = apart.topk(self.neighbours, largest=False).values.square().mean().clamp_min(1e-8)
        self.blend_logit.copy_((-0.5 * apart.square() / spread)[:, :, None].expand(-1, -1, 2))

    def distances(self, place: Float[Tensor, "N 2"], feature: Float[Tensor, "N f"]) -> Float[Tensor, "N K"]:
        """Distances in the joint space."""
        gaussians = torch.cat((place, self.feature_weight * feature), 1)
        return torch.cdist(gaussians, torch.cat((self.place, self.feature_weight * self.feature), 1))

    @torch.no_grad()
    def nearest(self, place: Float[Tensor, "N 2"], feature: Float[Tensor, "N f"]) -> Int64[Tensor, "N k"]:
        """The key points that each Gaussian follows."""
        return self.distances(place, feature).topk(self.neighbours, largest=False).indices

    def blend(self, nearest: Int64[Tensor, "N k"], shift: Shift) -> Shift:
        """What the Gaussians do while the key points do ``shift``.

        Places are blended by one softmax over the neighbours and turns by another; a turn of a key point does
        not carry its followers around it.
        """
        logits = self.blend_logit.gather(1, nearest[:, :, None].expand(-1, -1, 2))
        weight = torch.softmax(logits, dim=1)
        moved, turned = shift
        return (
            (weight[:, :, :1] * moved[nearest]).sum(1),
            (weight[:, :, 1:] * turned[nearest]).sum(1),
        )


def time_of(frame: float, frames: int) -> float:
    """The time of a frame in a clip of ``frames`` frames, which ends at 1."""
    return frame / max(frames - 1, 1)
