"""The image model that every rasteriser implements, its specification in torch, and the choice of another.

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

from importlib.util import find_spec

import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.splat.gaussians import GaussianSlice

BLUR_PX2 = 0.3
ALPHA_MIN = 1.0 / 255.0
ALPHA_MAX = 0.999
TRANSMITTANCE_MIN = 1e-4

# The device type each rasteriser runs on; None is any.
DEVICES = {"torch": None, "numba": "cpu", "gsplat": "cuda"}


def choose_device(backend: str) -> str:
    """Return the device type to train on with this rasteriser: CUDA if it can run there, else the CPU."""
    if backend == "auto":
        return "cuda" if torch.cuda.is_available() and find_spec("gsplat") else "cpu"
    return DEVICES.get(backend) or "cpu"


def choose_backend(device: str) -> str:
    """Return the rasteriser that ``"auto"`` means for tensors on this device type."""
    return {"cpu": "numba", "cuda": "gsplat" if find_spec("gsplat") else "torch"}.get(device, "torch")


def rasterize(
    means: Float[Tensor, "B K 2"],
    covariance: Float[Tensor, "*S K 3"],
    opacity: Float[Tensor, "B K"],
    color: Float[Tensor, "*S K 3"],
    background: Float[Tensor, " 3"],
    *,
    height: int,
    width: int,
    backend: str = "torch",
) -> Float[Tensor, "B 3 H W"]:
    """Draw B images of K Gaussians, differentiable in all five tensors.

    Args:
        means: Centres [px].
        covariance: xx, xy, yy [px^2], shared by all images or per image (S = B).
        opacity: In [0, 1].
        color: RGB, shared or per image like ``covariance``.
        background: RGB where the transmittance is left.
        height, width: Size of the images [px].
        backend: ``"torch"`` is the specification: any dtype and device, by autograd, with memory for about
            10 B K H W numbers. ``"numba"`` draws float32 on the CPU with ``numba.get_num_threads()`` threads,
            whose number changes no bit; its first call on a machine compiles the kernels (seconds).
            ``"gsplat"`` draws float32 on CUDA. ``"auto"`` takes the fastest on the tensors' device.

    Raises:
        ValueError: shapes, types or devices do not match, or the rasteriser is unknown or draws no such
            tensors.
        ImportError: gsplat is chosen and not installed, or has no compiled kernels.

    Source: the image model in `lagsplat.splat.image_model`.

    Example:
        >>> import lagsplat, torch
        >>> means, opacity = torch.tensor([[[8.0, 4.0]]]), torch.ones(1, 1)
        >>> covariance, color = torch.tensor([[[4.0, 0.0, 4.0]]]), torch.ones(1, 1, 3)
        >>> lagsplat.rasterize(means, covariance, opacity, color, torch.zeros(3), height=8, width=16).shape
        torch.Size([1, 3, 8, 16])
    """
    scene = GaussianSlice(means, covariance, opacity, color, background)
    require_scene(scene, height, width)
    backend = choose_backend(means.device.type) if backend == "auto" else backend
    if backend not in DEVICES:
        raise ValueError(f"there is no rasteriser {backend!r}: choose one of auto, {', '.join(DEVICES)}")
    device = DEVICES[backend]
    if device and (means.device.type != device or means.dtype != torch.float32):
        raise ValueError(
            f"the rasteriser {backend!r} draws float32 tensors on {device}, got {means.dtype} on "
            f"{means.device}: convert them, or choose 'torch', which draws any"
        )
    # Only the chosen module is imported, by a statement, because the dependency tracking of results reads
    # only statements.
    if backend == "numba":
        from lagsplat.splat.cpu.rasterize import draw_numba

        return draw_numba(scene, height, width)
    if backend == "gsplat":
        from lagsplat.splat.rasterize_gsplat import draw_gsplat

        return draw_gsplat(scene, height, width)
    return draw_torch(scene, height, width)


def require_scene(scene: GaussianSlice, height: int, width: int) -> None:
    """Check that the shapes, types and devices of a scene match.

    Raises:
        ValueError: names the argument, what it is and what it should be.
    """
    if height < 1 or width < 1:
        raise ValueError(f"cannot draw an image of {height} x {width} pixels: both must be at least 1")
    means = scene.means
    batch, count = means.shape[:2] if means.ndim == 3 else ("B", "K")
    shared = (count, 3)
    look = (batch, *shared) if scene.covariance.shape[:-1] == (batch, count) else shared
    shapes = ((batch, count, 2), look, (batch, count), look, (3,))
    for name, tensor, shape in zip(scene._fields, scene, shapes, strict=True):
        if tuple(tensor.shape) != shape:
            wanted = "(" + ", ".join(str(size) for size in shape) + ")"
            if shape is shared:  # the sizes of opacity can be the same numbers
                wanted += ", or one for each image, as covariance and color have it together"
            raise ValueError(f"{name} has shape {tuple(tensor.shape)}, expected {wanted}")
        if not tensor.is_floating_point() or tensor.dtype != means.dtype:
            raise ValueError(f"{name} is {tensor.dtype}, means {means.dtype}: use one floating type")
        if tensor.device != means.device:
            raise ValueError(f"{name} is on {tensor.device}, means on {means.device}: use one device")


def blur(covariance: Float[Tensor, "*S K 3"]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Entries xx, xy, yy of the blurred covariances in float64, and which of these are positive definite.

    The others are replaced by 1, 0, 1 before anything divides by them: autograd would turn an unused infinity
    into NaN.
    """
    xx, xy, yy = covariance.double().unbind(-1)
    xx, yy = xx + BLUR_PX2, yy + BLUR_PX2
    proper = covariance.isfinite().all(-1) & (xx > 0) & (xx * yy - xy**2 > 0)
    return torch.where(proper, xx, 1.0), torch.where(proper, xy, 0.0), torch.where(proper, yy, 1.0), proper


def draw_torch(scene: GaussianSlice, height: int, width: int) -> Float[Tensor, "B 3 H W"]:
    """Draw a scene in its own dtype, one image after the other: the specification of the others."""
    batch = len(scene.means)
    covariance, color = (part.expand(batch, -1, -1) for part in (scene.covariance, scene.color))
    frames = []
    for means, shape, opacity, look in zip(scene.means, covariance, scene.opacity, color, strict=True):
        alpha = evaluate_alphas(means, shape, opacity, height, width)
        after = torch.cumprod(1 - alpha, dim=0)
        # Transmittance never rises, so this keeps the Gaussians in front of the one that finishes the pixel.
        alpha = torch.where(after > TRANSMITTANCE_MIN, alpha, 0)
        after = torch.cumprod(1 - alpha, dim=0)
        ahead = torch.cat([after.new_ones(1, height, width), after])
        light = torch.einsum("khw,khw,kc->chw", alpha, ahead[:-1], look)
        frames.append(light + ahead[-1] * scene.background[:, None, None])
    return torch.stack(frames) if frames else scene.means.new_zeros(0, 3, height, width)


def evaluate_alphas(
    means: Float[Tensor, "K 2"],
    covariance: Float[Tensor, "K 3"],
    opacity: Float[Tensor, " K"],
    height: int,
    width: int,
) -> Float[Tensor, "K H W"]:
    """Alpha of each Gaussian in each pixel, 0 where it is skipped."""
    xx, xy, yy, proper = blur(covariance)
    drawn = proper & means.isfinite().all(1) & opacity.isfinite()
    determinant = xx * yy - xy**2
    conic = torch.stack([yy / determinant, -xy / determinant, xx / determinant])
    a, b, c = conic.to(means.dtype)[:, :, None, None]
    means = torch.where(drawn[:, None], means, 0)
    opacity = torch.where(drawn, opacity, 0)

    x = torch.arange(width, dtype=means.dtype, device=means.device) + 0.5
    y = torch.arange(height, dtype=means.dtype, device=means.device) + 0.5
    dx = x[None, None, :] - means[:, 0, None, None]
    dy = y[None, :, None] - means[:, 1, None, None]
    sigma = (a * dx**2 + c * dy**2) / 2 + b * dx * dy
    alpha = torch.clamp(opacity[:, None, None] * torch.exp(-sigma), max=ALPHA_MAX)
    return torch.where(alpha >= ALPHA_MIN, alpha, 0)
