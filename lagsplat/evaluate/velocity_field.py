"""Measure whether a decoder's primitives move with the matter or independently, at one state."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float32, Float64
from scipy.spatial import cKDTree

from lagsplat.array_types import Frames
from lagsplat.chart.chart import Chart
from lagsplat.io.files.artifact import load_artifact, save_artifact
from lagsplat.splat.image_model import ALPHA_MIN
from lagsplat.splat.losses import structural_dissimilarity
from lagsplat.stage1.autoencoder import to_images
from lagsplat.stage1.planar_decoder import PlanarDecoder

STILL = 1.5  # pixels within this factor of the quietest pixels' spread count as background
AT_ONCE = 32
KIND, SCHEMA = "velocity_maps", 1

Maps = dict[str, dict[str, np.ndarray]]


@dataclass(frozen=True)
class FastestMoment:
    """The training frame of the fastest motion: its raw latent and the latent's rate of change [1/s]."""

    frame: int
    z: Float64[np.ndarray, " d"]
    rate: Float64[np.ndarray, " d"]


def find_fastest_moment(chart: Chart) -> FastestMoment:
    """The frame where the smoothed encoded training motion is fastest in the metric; never at a cut."""
    train = chart.train.smoothed(chart.smoothing_frames)
    inner = np.concatenate([np.arange(start + 1, stop - 1) for start, stop in train.segments])
    slopes = train.clock.slope(train.latents, inner, (-1, 1))
    speed = np.einsum("ti,ij,tj->t", slopes, chart.metric, slopes)
    best = int(np.argmax(speed))
    frame = int(inner[best])
    return FastestMoment(frame, chart.to_raw(train.latents[[frame]])[0], slopes[best] @ chart.unwhiten)


def estimate_background(frames: Frames) -> Bool[np.ndarray, "H W"]:
    """Pixels that change over the frames by no more than their noise.

    The spread over time of the quietest half of the pixels estimates the noise.
    """
    chosen = np.asarray(frames[:: max(1, len(frames) // 100)], dtype=np.float64)
    spread = chosen.std(axis=0).mean(axis=-1)
    return spread <= max(STILL * float(np.quantile(spread, 0.25)), 1.0)


@torch.no_grad()
def compute_velocity_field(
    decoder: PlanarDecoder,
    frames: Frames,
    latents: Float64[np.ndarray, "T d"],
    moment: FastestMoment,
    *,
    window: int,
    neighbours: int,
    backend: str = "auto",
) -> tuple[dict[str, Any], dict[str, Float32[np.ndarray, "..."]]]:
    """Measures of a decoder, and its image and rendered speeds at a moment.

    ``l1`` and ``dissimilarity`` (1 - SSIM, in windows of ``window`` pixels) are over the ``frames`` that it
    was fitted to. ``roughness`` is the median over visible primitives of the mean difference of their
    velocity from those of their nearest visible ``neighbours`` [px/s], ``speed`` the median of their own.
    ``painted_still`` and ``painted_moving`` are the mean speeds [px/s], with speeds rendered in place of
    colours, over the still background and over the rest. The maps are ``picture`` (3,H,W) and ``speed``
    (H,W).

    Source: paper, Appendix "Deformation-Field Decoder at Equal Budget".
    """
    z = torch.as_tensor(moment.z, dtype=torch.float32)
    rate = torch.as_tensor(moment.rate, dtype=torch.float32)
    velocity = (decoder.jacobian(z) @ rate).double().numpy()
    scene = decoder.slices(z[None])[0]
    rough, visible = _roughness(scene.means[0], scene.opacity[0], velocity, decoder, neighbours)
    speeds = np.linalg.norm(velocity, axis=1)
    colour = torch.as_tensor(np.repeat(speeds[:, None], 3, axis=1), dtype=torch.float32)
    painted_scene = scene._replace(color=colour, background=torch.zeros(3))
    painted = decoder.draw([painted_scene], backend=backend)[0, 0].numpy()
    still = estimate_background(frames)
    picture = decoder.draw([scene], backend=backend)[0].clamp(0, 1).numpy()
    return {
        **_reconstruction(decoder, frames, latents, window=window, backend=backend),
        "roughness": rough,
        "speed": float(np.median(speeds[visible])) if visible.any() else None,
        "visible": int(visible.sum()),
        "painted_still": float(painted[still].mean()) if still.any() else None,
        "painted_moving": float(painted[~still].mean()) if (~still).any() else None,
        "parameters": sum(parameter.numel() for parameter in decoder.parameters()),
        "n_gaussians": len(velocity),
        "frame": moment.frame,
    }, {"picture": picture, "speed": painted}


def _roughness(
    means: torch.Tensor, opacity: torch.Tensor, velocity: np.ndarray, decoder: PlanarDecoder, neighbours: int
) -> tuple[float | None, np.ndarray]:
    at = means.double().numpy()
    inside = (at >= 0).all(axis=1) & (at[:, 0] <= decoder.width) & (at[:, 1] <= decoder.height)
    visible = inside & (opacity.numpy() >= ALPHA_MIN)
    if visible.sum() < 2:
        return None, visible
    count = min(neighbours, int(visible.sum()) - 1)
    near = cKDTree(at[visible]).query(at[visible], k=count + 1)[1][:, 1:]
    mine = velocity[visible]
    apart = np.linalg.norm(mine[near] - mine[:, None], axis=2).mean(axis=1)
    return float(np.median(apart)), visible


def _reconstruction(
    decoder: PlanarDecoder, frames: Frames, latents: np.ndarray, *, window: int, backend: str
) -> dict[str, float]:
    l1, dissimilarity = [], []
    for first in range(0, len(frames), AT_ONCE):
        truth = to_images(np.asarray(frames[first : first + AT_ONCE]))
        z = torch.as_tensor(latents[first : first + AT_ONCE], dtype=torch.float32)
        drawn = decoder.draw(decoder.slices(z), backend=backend)
        l1.append((drawn - truth).abs().mean(dim=(1, 2, 3)))
        dissimilarity += [
            structural_dissimilarity(a[None], b[None], window=window)
            for a, b in zip(drawn, truth, strict=True)
        ]
    return {"l1": float(torch.cat(l1).mean()), "dissimilarity": float(torch.stack(dissimilarity).mean())}


def save_maps(
    path: str | os.PathLike[str],
    maps: Mapping[str, Mapping[str, np.ndarray]],
    measures: Mapping[str, Mapping[str, Any]],
    header: Mapping[str, Any],
) -> None:
    """Write the maps of each decoder, by name, with its measures and a header."""
    tensors = {f"{name}.{key}": value for name, own in maps.items() for key, value in own.items()}
    save_artifact(path, tensors, {"kind": KIND, "schema": SCHEMA, **header, "measures": dict(measures)})


def load_maps(path: str | os.PathLike[str]) -> tuple[Maps, dict[str, dict[str, Any]]]:
    """Read the maps and the measures of each decoder."""
    tensors, header = load_artifact(path, kind=KIND, schema=SCHEMA)
    maps: Maps = {name: {} for name in header["measures"]}
    for key, value in tensors.items():
        name, _, what = key.partition(".")
        maps[name][what] = value
    return maps, header["measures"]
