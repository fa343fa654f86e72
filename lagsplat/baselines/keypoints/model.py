"""The key-point forecaster: Gaussians, the motion network and key points that move them, graph networks.

The Gaussians are planar, each with a place, a shape, a colour and a motion feature. At the end: the predicted
paths of key points and the frames that follow.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Float32, Int64
from torch import Tensor, nn

from lagsplat.array_types import Frames
from lagsplat.baselines.config import ForecasterConfig
from lagsplat.io.files.artifact import StrPath, load_artifact, restore_module, save_artifact
from lagsplat.splat.image_model import rasterize
from lagsplat.stage1.gaussian_initialization import measure_edges, scatter_points

KIND, SCHEMA = "forecaster", 1


@dataclass(frozen=True)
class ForecasterArchitecture:
    """What decides the shape of a forecaster; ``frames`` is the number of its training frames."""

    n_gaussians: int
    feature: int
    octaves: int
    hidden: int
    layers: int
    key_points: int
    neighbours: int
    feature_weight: float
    history: int
    graph_hidden: int
    graph_blocks: int
    height: int
    width: int
    frames: int


def read_forecaster_architecture(
    config: ForecasterConfig, *, height: int, width: int, frames: int
) -> ForecasterArchitecture:
    """The shape of a forecaster for a clip of ``frames`` training frames of this size [px]."""
    motion, graph = config.motion, config.graph
    names = ("feature", "octaves", "hidden", "layers", "key_points", "neighbours", "feature_weight")
    return ForecasterArchitecture(
        n_gaussians=config.n_gaussians,
        **{name: getattr(motion, name) for name in names},
        history=graph.history,
        graph_hidden=graph.hidden,
        graph_blocks=graph.blocks,
        height=height,
        width=width,
        frames=frames,
    )


Shift = tuple[Float[Tensor, "_ 2"], Float[Tensor, "_ 1"]]  # displacements [half widths] and rotations [rad]


class Forecaster(nn.Module):
    """Gaussians that follow key points, and two graph networks that predict the key points.

    ``places`` and ``turns`` are the graph networks, for positions and for (cosine, sine) of the rotations.

    Source: Zhao et al. 2024, arXiv:2405.19745, reimplemented for two dimensions and one camera.
    """

    def __init__(self, of: ForecasterArchitecture, *, backend: str = "auto") -> None:
        super().__init__()
        self.architecture, self.backend = of, backend
        self.scene = KeyPointScene(of.n_gaussians, of.feature, height=of.height, width=of.width)
        self.motion = MotionNet(of.feature, octaves=of.octaves, hidden=of.hidden, layers=of.layers)
        sizes = (of.n_gaussians, of.key_points, of.feature)
        self.keys = KeyPoints(*sizes, neighbours=of.neighbours, feature_weight=of.feature_weight)
        graph = {"history": of.history, "hidden": of.graph_hidden, "blocks": of.graph_blocks}
        self.places = GraphNet(2 * of.key_points, **graph)
        self.turns = GraphNet(2 * of.key_points, **graph)

    def shift(
        self, points: "KeyPointScene | KeyPoints", frame: float, *, noise: Float[Tensor, "_ 2"] | float = 0.0
    ) -> Shift:
        """The motion at a frame of every Gaussian or key point; ``noise`` is added to its place."""
        time = frame / max(self.architecture.frames - 1, 1)  # from 0 to 1 over the training frames
        return self.motion(points.feature, points.place.detach() + noise, time)

    def draw(self, shift: Shift) -> Float[Tensor, "1 3 H W"]:
        """The image with every Gaussian displaced and rotated."""
        moved, turned = shift
        return self.scene.draw(self.scene.place + moved, self.scene.angle + turned, backend=self.backend)

    def nearest(self) -> Tensor:
        """The key points that each Gaussian follows, (N, neighbours)."""
        return self.keys.nearest(self.scene.place, self.scene.feature)


def save_forecaster(path: StrPath, forecaster: Forecaster, header: Mapping[str, Any]) -> None:
    """Write the weights and the architecture."""
    header = {"kind": KIND, "schema": SCHEMA, **header, "architecture": asdict(forecaster.architecture)}
    save_artifact(path, forecaster.state_dict(), header)


def load_forecaster(path: StrPath, *, backend: str = "auto") -> tuple[Forecaster, dict[str, Any]]:
    """Read a forecaster and its header; errors as `lagsplat.io.files.artifact.load_artifact`."""
    tensors, header = load_artifact(path, kind=KIND, schema=SCHEMA)
    forecaster = Forecaster(ForecasterArchitecture(**header["architecture"]), backend=backend)
    return restore_module(forecaster, tensors, path), header


def fourier_features(value: Float[Tensor, "N m"], octaves: int) -> Float[Tensor, "N w"]:
    """Sines and cosines of ``2^k value`` for ``octaves`` values of k, without the value itself."""
    scaled = (value[:, :, None] * 2.0 ** torch.arange(octaves, device=value.device)).flatten(1)
    return torch.cat((scaled.sin(), scaled.cos()), dim=1)


class MotionNet(nn.Module):
    """Displacement and rotation from a feature, a place and a time; initially zero.

    Source: the published forecaster, its deformation network in two dimensions.
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
        """Displacement and rotation at ``time``, which runs from 0 to 1 over the clip."""
        when = fourier_features(place.new_full((1, 1), time), self.octaves).expand(len(place), -1)
        value = torch.cat((feature, fourier_features(place, self.octaves), when), dim=1)
        for layer in self.layers:
            value = torch.relu(layer(value))
        moved = self.head(value)
        return moved[:, :2], moved[:, 2:]


class KeyPoints(nn.Module):
    """``K`` points that the motion network moves, and how much each Gaussian follows each of them.

    A Gaussian follows its nearest points in the joint space of place and feature; one blend of their motions
    displaces it and another rotates it. A logit for every pair replaces the published hash grid: pairs that
    are not neighbours have no effect.
    """

    def __init__(self, n: int, k: int, feature: int, *, neighbours: int, feature_weight: float) -> None:
        super().__init__()
        self.neighbours, self.feature_weight = neighbours, feature_weight
        self.place = nn.Parameter(torch.zeros(k, 2))
        self.feature = nn.Parameter(torch.zeros(k, feature))
        self.blend_logit = nn.Parameter(torch.zeros(n, k, 2))

    @torch.no_grad()
    def gather(self, place: Float[Tensor, "N 2"], feature: Float[Tensor, "N f"], *, seed: int) -> None:
        """Initialise the points by k-means on place and feature of the Gaussians."""
        from sklearn.cluster import KMeans  # a second to import, which only this needs

        joint = torch.cat((place, feature), 1).double().numpy()
        clusters = KMeans(len(self.place), n_init=1, random_state=seed).fit(joint)
        centres = torch.as_tensor(clusters.cluster_centers_).to(self.place)
        self.place.copy_(centres[:, :2])
        self.feature.copy_(centres[:, 2:])
        apart = self.distances(place, feature)
        spread = apart.topk(self.neighbours, largest=False).values.square().mean().clamp_min(1e-8)
        self.blend_logit.copy_((-0.5 * apart.square() / spread)[:, :, None].expand(-1, -1, 2))

    def distances(self, place: Float[Tensor, "N 2"], feature: Float[Tensor, "N f"]) -> Float[Tensor, "N K"]:
        """Distances between Gaussians and key points in the joint space."""
        gaussians = torch.cat((place, self.feature_weight * feature), 1)
        return torch.cdist(gaussians, torch.cat((self.place, self.feature_weight * self.feature), 1))

    @torch.no_grad()
    def nearest(self, place: Float[Tensor, "N 2"], feature: Float[Tensor, "N f"]) -> Int64[Tensor, "N k"]:
        """The key points that each Gaussian follows."""
        return self.distances(place, feature).topk(self.neighbours, largest=False).indices

    def blend(self, nearest: Int64[Tensor, "N k"], shift: Shift) -> Shift:
        """The motion of the Gaussians when the key points move by ``shift``.

        One softmax over the neighbours blends places and another rotations; a key point's rotation does not
        carry its followers around it.
        """
        logits = self.blend_logit.gather(1, nearest[:, :, None].expand(-1, -1, 2))
        weight = torch.softmax(logits, dim=1)
        moved, turned = shift
        return (weight[:, :, :1] * moved[nearest]).sum(1), (weight[:, :, 1:] * turned[nearest]).sum(1)


class GraphConvolution(nn.Module):
    """``A (X W) + b`` with a dense, learned matrix ``A`` between nodes."""

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
    """A graph convolution, batch normalisation by node and feature, and a tanh."""

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

    The map need not be a contraction: a long rollout may come to rest, decay or orbit.

    Source: the published forecaster, its graph network.
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


FEATURE_START = 1e-3


class KeyPointScene(nn.Module):
    """``N`` Gaussians in half widths of the image: x from -1 to 1, y likewise about the middle row.

    Sizes are in pixels. Only places and angles change with time, not colour, opacity or size. They are
    rendered in the order of their index by the package's image model.
    """

    def __init__(self, n: int, feature: int, *, height: int, width: int) -> None:
        super().__init__()
        self.height, self.width = height, width
        self.place = nn.Parameter(torch.zeros(n, 2))
        self.log_scale = nn.Parameter(torch.zeros(n, 2))
        self.angle = nn.Parameter(torch.zeros(n, 1))
        self.color_logit = nn.Parameter(torch.zeros(n, 3))
        self.opacity_logit = nn.Parameter(torch.zeros(n))
        self.background_logit = nn.Parameter(torch.zeros(3))
        self.feature = nn.Parameter(torch.zeros(n, feature))

    def draw(
        self, place: Float[Tensor, "N 2"], angle: Float[Tensor, "N 1"], *, backend: str
    ) -> Float[Tensor, "1 3 H W"]:
        """The image with its Gaussians at ``place`` [half widths], rotated to ``angle`` [rad]."""
        half = self.width / 2
        means = place * half + place.new_tensor([half, self.height / 2])
        return rasterize(
            means[None],
            self.covariance(angle),
            torch.sigmoid(self.opacity_logit)[None],
            torch.sigmoid(self.color_logit),
            torch.sigmoid(self.background_logit),
            height=self.height,
            width=self.width,
            backend=backend,
        )

    def covariance(self, angle: Float[Tensor, "N 1"]) -> Float[Tensor, "N 3"]:
        """Covariances xx, xy, yy [px^2] at these angles."""
        first, second = self.log_scale.mul(2).exp().unbind(1)
        cos, sin = torch.cos(angle[:, 0]), torch.sin(angle[:, 0])
        xx, xy = cos * cos * first + sin * sin * second, cos * sin * (first - second)
        return torch.stack((xx, xy, sin * sin * first + cos * cos * second), dim=1)


@torch.no_grad()
def place_key_point_scene(
    scene: KeyPointScene, frames: Frames, *, sigma: float, opacity: float, rng: np.random.Generator
) -> None:
    """Place the Gaussians where the first frame has edges and where frames differ, with the colours there.

    ``sigma`` is their initial size over the image height.
    """
    first = np.asarray(frames[0]) / 255.0
    spread = np.asarray(frames[:: max(1, len(frames) // 50)]).std(axis=0).mean(-1)
    edges = measure_edges(first)
    busy = edges / max(edges.sum(), 1e-12) + spread / max(spread.sum(), 1e-12)
    points, colors = scatter_points(first, busy, len(scene.place), rng)
    half = scene.width / 2
    scene.place.copy_(torch.as_tensor((points - [half, scene.height / 2]) / half))
    scene.log_scale.fill_(math.log(sigma * scene.height))
    scene.opacity_logit.fill_(math.log(opacity / (1 - opacity)))
    scene.color_logit.copy_(colors)
    scene.background_logit.copy_(torch.as_tensor(first.mean((0, 1)).clip(0.01, 0.99)).logit())
    drawn = rng.uniform(-FEATURE_START, FEATURE_START, scene.feature.shape)
    scene.feature.copy_(torch.as_tensor(drawn))


class KeyPointPath(NamedTuple):
    """Positions [half widths] and rotations (cosine, sine) of the key points at consecutive frames."""

    places: Float32[np.ndarray, "N K 2"]
    turns: Float32[np.ndarray, "N K 2"]


@torch.no_grad()
def fit_path(forecaster: Forecaster, frames: Float[np.ndarray, " N"]) -> KeyPointPath:
    """The key points by the motion network at these frames.

    Within the training frames this is the fit; beyond them the network extrapolates in time.
    """
    places, turns = [], []
    for frame in frames:
        moved, turned = forecaster.shift(forecaster.keys, float(frame))
        places.append(forecaster.keys.place + moved)
        turns.append(torch.cat((turned.cos(), turned.sin()), 1))
    return KeyPointPath(torch.stack(places).numpy(), torch.stack(turns).numpy())


@torch.no_grad()
def continue_path(forecaster: Forecaster, steps: int) -> KeyPointPath:
    """The last training frame and ``steps`` frames after it, with every prediction fed back.

    Cosines and sines are normalised to unit length after every step.
    """
    of = forecaster.architecture
    past = fit_path(forecaster, np.arange(of.frames - of.history, of.frames, dtype=np.float64))
    places = [torch.from_numpy(place).flatten() for place in past.places]
    turns = [torch.from_numpy(turn).flatten() for turn in past.turns]
    for _ in range(steps):
        places.append(forecaster.places(torch.stack(places[-of.history :])[None])[0])
        turns.append(wrap_angle(forecaster.turns(torch.stack(turns[-of.history :])[None])[0]))
    kept = (torch.stack(series[of.history - 1 :]).unflatten(1, (-1, 2)).numpy() for series in (places, turns))
    return KeyPointPath(*kept)


def wrap_angle(turns: Float[Tensor, "*B nodes"]) -> Float[Tensor, "*B nodes"]:
    """Pairs of cosine and sine, normalised to length one."""
    pairs = turns.unflatten(-1, (-1, 2))
    return (pairs / pairs.norm(dim=-1, keepdim=True).clamp_min(1e-6)).flatten(-2)


@torch.no_grad()
def draw_path(
    forecaster: Forecaster, path: KeyPointPath, at: Float[np.ndarray, " N"]
) -> Float32[np.ndarray, "N 3 H W"]:
    """Images at positions along a path, in its steps: linear between them, constant beyond its ends."""
    nearest, images = forecaster.nearest(), []
    last = len(path.places) - 1
    for place in np.clip(at, 0, last):
        low = min(int(place), max(last - 1, 0))
        high, part = min(low + 1, last), float(place - low)
        places, turns = ((1 - part) * series[low] + part * series[high] for series in path)
        moved, turn = torch.from_numpy(places).float(), torch.from_numpy(turns).float()
        angle = torch.atan2(turn[:, 1:], turn[:, :1])
        images.append(forecaster.draw(forecaster.keys.blend(nearest, (moved - forecaster.keys.place, angle))))
    return torch.cat(images).clamp(0.0, 1.0).numpy()
