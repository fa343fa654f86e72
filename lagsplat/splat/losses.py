"""Terms of the reconstruction loss, each a scalar."""

import math
from functools import cache

import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.array_types import Images

SSIM_SIGMA = 1.5  # [px], of the window: Wang et al. 2004, doi:10.1109/TIP.2003.819861
SSIM_C1, SSIM_C2 = 0.01**2, 0.03**2  # the same, for colours in [0, 1]
EQUAL_AXES = 1e-9  # margin on a cosine that is 1 where two axes of an ellipsoid are equal


@cache
def make_ssim_filter(length: int, window: int) -> Float[Tensor, "valid length"]:
    """Matrix that averages ``length`` samples under a Gaussian window, without padding.

    A window wider than the image shrinks to the largest odd one that fits.
    """
    window = min(window, length - (length + 1) % 2)
    taps = torch.exp(-0.5 * ((torch.arange(window) - window // 2) / SSIM_SIGMA) ** 2)
    valid = length - window + 1
    rows = torch.zeros(valid, length)
    for first in range(valid):
        rows[first, first : first + window] = taps / taps.sum()
    return rows


def structural_dissimilarity(drawn: Images, truth: Images, *, window: int) -> Float[Tensor, ""]:
    """``1 - SSIM``, averaged over images, channels and the positions where the window fits.

    Two matrix products apply the window: on a CPU several times faster than a depthwise convolution for
    images this small.

    Source: Wang et al. 2004, doi:10.1109/TIP.2003.819861.
    """
    rows = make_ssim_filter(drawn.shape[2], window).to(drawn)
    columns = make_ssim_filter(drawn.shape[3], window).to(drawn).T
    maps = torch.cat((drawn, truth, drawn * drawn, truth * truth, drawn * truth))
    mean_x, mean_y, xx, yy, xy = (rows @ maps @ columns).chunk(5)
    variances = (xx - mean_x**2) + (yy - mean_y**2)
    covariance = xy - mean_x * mean_y
    similarity = (2 * mean_x * mean_y + SSIM_C1) * (2 * covariance + SSIM_C2)
    similarity = similarity / ((mean_x**2 + mean_y**2 + SSIM_C1) * (variances + SSIM_C2))
    return 1 - similarity.mean()


def anisotropy(covariance: Float[Tensor, "K m"], *, limit: float) -> Float[Tensor, ""]:
    """Mean log ratio by which drawn Gaussians exceed the aspect ratio ``limit``.

    ``covariance`` holds lower triangles row by row, m = 3 in the plane and 6 in space.

    Source: paper, Supervision: the regularizer that caps the aspect ratio of the rendered ellipsoids.
    """
    largest, smallest = _extremes_of_plane(covariance) if covariance.shape[1] == 3 else _extremes(covariance)
    log_ratio = 0.5 * torch.log(largest / smallest.clamp_min(1e-9))
    return torch.relu(log_ratio - torch.tensor(limit).log()).mean()


def _extremes_of_plane(covariance: Float[Tensor, "K 3"]) -> tuple[Tensor, Tensor]:
    """Largest and smallest variance along an axis, in the plane."""
    xx, xy, yy = covariance.unbind(1)
    middle = (xx + yy) / 2
    # The floor under the root keeps its derivative finite for a circle.
    spread = torch.sqrt((xx - yy) ** 2 / 4 + xy**2 + 1e-12 * middle**2)
    return middle + spread, middle - spread


def _extremes(covariance: Float[Tensor, "K 6"]) -> tuple[Tensor, Tensor]:
    """Largest and smallest variance in space, by the trigonometric solution of the cubic.

    Batched eigenvalue solvers take far longer. In float64 against cancellation in the smallest.

    Source: Smith 1961, doi:10.1145/355578.366316.
    """
    xx, xy, yy, xz, yz, zz = covariance.double().unbind(1)
    middle = (xx + yy + zz) / 3
    a, b, c = xx - middle, yy - middle, zz - middle
    # The floor under the root and the bound on the cosine keep derivatives finite where axes are equal.
    spread = torch.sqrt((a * a + b * b + c * c + 2 * (xy * xy + xz * xz + yz * yz)) / 6 + 1e-12 * middle**2)
    determinant = a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)
    cosine = (determinant / (2 * spread**3)).clamp(-1 + EQUAL_AXES, 1 - EQUAL_AXES)
    angle = torch.acos(cosine) / 3
    ends = (middle + 2 * spread * torch.cos(angle), middle + 2 * spread * torch.cos(angle + 2 * math.pi / 3))
    return ends[0].to(covariance), ends[1].to(covariance)


def nonlocal_filter(
    filters: list[Float[Tensor, "_ _ k k"]],
) -> Float[Tensor, ""]:
    """Roughness of convolution filters: squared differences of taps, weighted by their closeness.

    ``sum_ab exp(-|x_a - x_b|^2) (w_a - w_b)^2 / 2`` over the taps of each filter [px], summed over filters.

    Source: paper eq. (recon_loss), the nonlocal filter penalty of Zhu et al. 2025.
    """
    side = filters[0].shape[-1]
    position = torch.arange(side, dtype=filters[0].dtype, device=filters[0].device)
    along = torch.exp(-((position[:, None] - position[None]) ** 2))
    taps = torch.cat([bank.flatten(0, 1) for bank in filters])
    degree = along.sum(1)
    # The kernel over taps is the product of one over rows and one over columns.
    own = torch.einsum("fij,i,j->", taps * taps, degree, degree)
    return own - (taps * (along @ taps @ along)).sum()
