"""Constants and argument checks of the image model that every rasteriser implements.

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
