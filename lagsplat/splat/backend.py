"""Choice of the rasteriser: a name and a device in, a function out."""

from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec

import torch
from torch import Tensor

Rasterizer = Callable[..., Tensor]

MODULES = {
    "torch": "lagsplat.splat.raster_torch",
    "numba": "lagsplat.splat.raster_numba",
    "gsplat": "lagsplat.splat.raster_gsplat",
}


def rasterizer(name: str, device: torch.device | str) -> Rasterizer:
    """The ``rasterize(means, covariance, opacity, color, background, *, height, width)`` of that name.

    ``"auto"`` takes gsplat on a CUDA device where it is installed, Numba on the CPU, and torch anywhere
    else. Only the chosen module is imported.

    Raises:
        ValueError: unknown name, or one that cannot draw on ``device``.
    """
    kind = torch.device(device).type
    if name == "auto":
        name = {"cpu": "numba", "cuda": "gsplat" if find_spec("gsplat") else "torch"}.get(kind, "torch")
    if name not in MODULES:
        raise ValueError(f"there is no rasteriser {name!r}: choose one of auto, {', '.join(MODULES)}")
    needed = {"numba": "cpu", "gsplat": "cuda"}.get(name, kind)
    if kind != needed:
        raise ValueError(f"the rasteriser {name!r} draws on {needed}, not {kind}: choose 'auto' or 'torch'")
    rasterize: Rasterizer = import_module(MODULES[name]).rasterize
    return rasterize
