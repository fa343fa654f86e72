"""Choose the rasteriser by name and device."""

from collections.abc import Callable
from importlib.util import find_spec

import torch
from torch import Tensor

Rasterizer = Callable[..., Tensor]

# The device type each rasteriser runs on; None is any.
DEVICES = {"torch": None, "numba": "cpu", "gsplat": "cuda"}


def choose_device(name: str) -> str:
    """Return the device type to train on with this rasteriser: CUDA if it can run there, else the CPU."""
    if name == "auto":
        return "cuda" if torch.cuda.is_available() and find_spec("gsplat") else "cpu"
    return DEVICES.get(name) or "cpu"


def choose_rasterizer(name: str, device: torch.device | str) -> Rasterizer:
    """Return ``rasterize(means, covariance, opacity, color, background, *, height, width)`` by name.

    ``"auto"`` takes gsplat on a CUDA device if it is installed, Numba on the CPU, and torch elsewhere. Only
    the chosen module is imported.

    Raises:
        ValueError: unknown name, or a rasteriser that cannot run on ``device``.
    """
    kind = torch.device(device).type
    if name == "auto":
        name = {"cpu": "numba", "cuda": "gsplat" if find_spec("gsplat") else "torch"}.get(kind, "torch")
    if name not in DEVICES:
        raise ValueError(f"there is no rasteriser {name!r}: choose one of auto, {', '.join(DEVICES)}")
    if DEVICES[name] not in (None, kind):
        raise ValueError(
            f"the rasteriser {name!r} draws on {DEVICES[name]}, not {kind}: choose 'auto' or 'torch'"
        )
    # Import statements, because the dependency tracking of results reads only statements.
    if name == "numba":
        from lagsplat.splat.cpu.rasterize import rasterize as on_cpu

        return on_cpu
    if name == "gsplat":
        from lagsplat.splat.rasterize_gsplat import rasterize as on_cuda

        return on_cuda
    from lagsplat.splat.rasterize_torch import rasterize as anywhere

    return anywhere
