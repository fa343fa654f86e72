"""The image model that every rasteriser implements, its argument checks, and the choice of a rasteriser.

A Gaussian with centre ``m``, covariance ``S`` and opacity ``o`` covers the pixel centred at ``x`` with
``alpha = min(0.999, o exp(-sigma))``, ``sigma = (x - m)^T (S + 0.3 I)^-1 (x - m) / 2``. Gaussians are
composited front to back in index order; one with ``alpha < 1/255`` is skipped. The first Gaussian that would
bring a pixel's transmittance to 1e-4 or less finishes the pixel and is not composited. The remaining
transmittance shows the background. This is gsplat's "classic" mode in two dimensions; as there, the clamp at
0.999 passes no gradient. `lagsplat.splat.projection` first projects Gaussians in space and sorts them.

A Gaussian is not drawn, and receives no gradient, if its centre, covariance or opacity is not finite, its
opacity is below 1/255, or its blurred covariance is not positive definite. Opacities lie in [0, 1].

Source: Kerbl et al. 2023, doi:10.1145/3592433; constants as in gsplat 1.5.
"""

from collections.abc import Callable
from importlib.util import find_spec

import torch
from torch import Tensor

BLUR_PX2 = 0.3
ALPHA_MIN = 1.0 / 255.0
ALPHA_MAX = 0.999
TRANSMITTANCE_MIN = 1e-4


def require_scene(
    means: Tensor,
    covariance: Tensor,
    opacity: Tensor,
    color: Tensor,
    background: Tensor,
    *,
    height: int,
    width: int,
) -> None:
    """Check that the shapes, types and devices of a scene match.

    Raises:
        ValueError: names the argument, what it is and what it should be.
    """
    if height < 1 or width < 1:
        raise ValueError(f"cannot draw an image of {height} x {width} pixels: both must be at least 1")
    batch, count = means.shape[:2] if means.ndim == 3 else ("B", "K")
    shared = (count, 3)
    look = (batch, *shared) if covariance.shape[:-1] == (batch, count) else shared
    expected = {
        "means": (means, (batch, count, 2)),
        "covariance": (covariance, look),
        "opacity": (opacity, (batch, count)),
        "color": (color, look),
        "background": (background, (3,)),
    }
    for name, (tensor, shape) in expected.items():
        if tuple(tensor.shape) != shape:
            wanted = ", ".join(str(size) for size in shape)
            other = (
                ", or one for each image, as covariance and color have it together" if shape == shared else ""
            )
            raise ValueError(f"{name} has shape {tuple(tensor.shape)}, expected ({wanted}){other}")
        if not tensor.is_floating_point() or tensor.dtype != means.dtype:
            raise ValueError(f"{name} is {tensor.dtype}, means {means.dtype}: use one floating type")
        if tensor.device != means.device:
            raise ValueError(f"{name} is on {tensor.device}, means on {means.device}: use one device")


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
