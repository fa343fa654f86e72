"""Predict key points by the graph networks, and render the frames that follow."""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor

from lagsplat.baselines.keypoints.model import Forecaster


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
        moved, turn = (
            torch.from_numpy((1 - part) * series[low] + part * series[high]).float() for series in path
        )
        angle = torch.atan2(turn[:, 1:], turn[:, :1])
        images.append(forecaster.draw_keys((moved - forecaster.keys.place, angle), nearest))
    return torch.cat(images).clamp(0.0, 1.0).numpy()
