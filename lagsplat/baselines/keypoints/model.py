"""The key-point forecaster as a whole, and its file."""

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from jaxtyping import Float
from torch import Tensor, nn

from lagsplat.baselines.keypoints.config import ForecasterConfig
from lagsplat.baselines.keypoints.graph import GraphNet
from lagsplat.baselines.keypoints.motion import KeyPoints, MotionNet, Shift, time_of
from lagsplat.baselines.keypoints.scene import Scene
from lagsplat.io.artefact import load_artefact, save_artefact
from lagsplat.io.restore import restore

KIND, SCHEMA = "forecaster", 1


@dataclass(frozen=True)
class Architecture:
    """What decides the shape of a forecaster; ``frames`` are those it was trained on."""

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


def architecture_of(config: ForecasterConfig, *, height: int, width: int, frames: int) -> Architecture:
    """The shape of a forecaster for a clip of ``frames`` training frames."""
    motion, graph = config.motion, config.graph
    return Architecture(
        n_gaussians=config.n_gaussians,
        feature=motion.feature,
        octaves=motion.octaves,
        hidden=motion.hidden,
        layers=motion.layers,
        key_points=motion.key_points,
        neighbours=motion.neighbours,
        feature_weight=motion.feature_weight,
        history=graph.history,
        graph_hidden=graph.hidden,
        graph_blocks=graph.blocks,
        height=height,
        width=width,
        frames=frames,
    )


class Forecaster(nn.Module):
    """Gaussians that follow key points, and two graph networks that carry the key points on.

    ``places`` and ``turns`` are the graph networks, for positions and for (cosine, sine) of the turns.

    Source: facts of Zhao et al. 2024, arXiv:2405.19745, written anew for two dimensions and one camera.
    """

    def __init__(self, of: Architecture, *, backend: str = "auto") -> None:
        super().__init__()
        self.architecture, self.backend = of, backend
        self.scene = Scene(of.n_gaussians, of.feature, height=of.height, width=of.width)
        self.motion = MotionNet(of.feature, octaves=of.octaves, hidden=of.hidden, layers=of.layers)
        self.keys = KeyPoints(
            of.n_gaussians,
            of.key_points,
            of.feature,
            neighbours=of.neighbours,
            feature_weight=of.feature_weight,
        )
        self.places, self.turns = (
            GraphNet(2 * of.key_points, history=of.history, hidden=of.graph_hidden, blocks=of.graph_blocks)
            for _ in range(2)
        )

    def free_shift(self, frame: float, *, noise: Float[Tensor, "N 2"] | float = 0.0) -> Shift:
        """What every Gaussian does at a frame by its own feature; ``noise`` is added to where it is told to
        be."""
        told = self.scene.place.detach() + noise
        return self.motion(self.scene.feature, told, time_of(frame, self.architecture.frames))

    def key_shift(self, frame: float, *, noise: Float[Tensor, "K 2"] | float = 0.0) -> Shift:
        """What the key points do at a frame."""
        told = self.keys.place.detach() + noise
        return self.motion(self.keys.feature, told, time_of(frame, self.architecture.frames))

    def draw(self, shift: Shift) -> Float[Tensor, "1 3 H W"]:
        """The picture with every Gaussian displaced and turned."""
        moved, turned = shift
        return self.scene.draw(self.scene.place + moved, self.scene.angle + turned, backend=self.backend)

    def draw_keys(self, shift: Shift, nearest: Tensor) -> Float[Tensor, "1 3 H W"]:
        """The picture with the key points displaced and turned and the Gaussians following them."""
        return self.draw(self.keys.blend(nearest, shift))

    def nearest(self) -> Tensor:
        """The key points that each Gaussian follows, (N, neighbours)."""
        return self.keys.nearest(self.scene.place, self.scene.feature)


def save_forecaster(path: str | os.PathLike[str], forecaster: Forecaster, header: Mapping[str, Any]) -> None:
    """Write the weights and what is needed to build the same model again."""
    header = {"kind": KIND, "schema": SCHEMA, **header, "architecture": asdict(forecaster.architecture)}
    save_artefact(path, forecaster.state_dict(), header)


def load_forecaster(
    path: str | os.PathLike[str], *, backend: str = "auto"
) -> tuple[Forecaster, dict[str, Any]]:
    """Read a forecaster and its header.

    Raises:
        FileNotFoundError: nothing is at ``path``.
        ValueError: the file is no forecaster, or one of another schema.
    """
    tensors, header = load_artefact(path, kind=KIND, schema=SCHEMA)
    forecaster = Forecaster(Architecture(**header["architecture"]), backend=backend)
    return restore(forecaster, tensors, path), header
