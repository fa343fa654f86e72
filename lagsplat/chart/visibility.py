"""PCA whitening of latents, the visibility metric and the intrinsic dimension."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from lagsplat.array_types import Series

Decode = Callable[[Float[Tensor, "B d"]], Tensor]  # images `(B, 3, H, W)` at whitened latents `(B, d)`

CHUNK = 32
LARGEST_ERROR = 0.3  # relative difference of the two step sizes, above which noise or curvature dominates


@dataclass(frozen=True)
class Visibility:
    """``metric`` has trace ``d``; ``metric * scale`` is the mean squared image change per whitened unit,
    summed over pixels and channels. ``condition`` is the ratio of the extreme eigenvalues.
    """

    metric: Float64[np.ndarray, "d d"]
    scale: float
    condition: float


def measure_visibility(decode: Decode, q: Series, *, step: float) -> Visibility:
    """Average of ``(dI/dq)^T (dI/dq)`` over the whitened latents ``q``, by central differences.

    Differences of width ``step`` and ``2 step`` are combined by Richardson's rule, exact to fourth order.
    The rasteriser drops a Gaussian below 1/255 of opacity: the effect of such a jump grows as the step
    shrinks, while a long step sees curvature. On 2048 trained Gaussians the trace is level within 2 % between
    0.01 and 0.04 whitened units.

    Raises:
        ValueError: the two steps give metrics that differ by three tenths, or the image does not change.

    Source: paper eq. (visibility).
    """
    near, far, sharp = totals = np.zeros((3, q.shape[1], q.shape[1]))
    for first in range(0, len(q), CHUNK):
        part = torch.from_numpy(np.ascontiguousarray(q[first : first + CHUNK]))
        slope, wide = differentiate_images(decode, part, step), differentiate_images(decode, part, 2.0 * step)
        for total, each in zip(totals, (slope, wide, (4.0 * slope - wide) / 3.0), strict=True):
            total += torch.einsum("bip,bjp->ij", each, each).numpy() / len(q)
    size = np.linalg.norm(near)
    if not size > 0.0:
        raise ValueError("no latent direction changes the image: check what stage 1 learned")
    error = float(np.linalg.norm(near - far) / size)
    if error > LARGEST_ERROR:
        raise ValueError(
            f"the visibility metric changes by {error:.0%} between difference steps {step:g} and "
            f"{2 * step:g}: lower chart.visibility_step where the image bends, raise it where it flickers"
        )
    symmetric = 0.5 * (sharp + sharp.T)
    scale = float(np.trace(symmetric)) / len(symmetric)
    values = np.linalg.eigvalsh(symmetric)
    condition = float(values[-1] / values[0]) if values[0] > 0.0 else float("inf")
    return Visibility(symmetric / scale, scale, condition)


@torch.no_grad()
def differentiate_images(decode: Decode, q: Float[Tensor, "B d"], step: float) -> Float[Tensor, "B d P"]:
    """Change of the pixels with each latent, by central differences of width ``step``."""
    shift = step * torch.eye(q.shape[1], dtype=q.dtype)
    ahead = torch.stack([decode(q + row).flatten(1).double() for row in shift], 1)
    behind = torch.stack([decode(q - row).flatten(1).double() for row in shift], 1)
    return (ahead - behind) / (2.0 * step)


def estimate_intrinsic_dimension(q: Series, *, frames: int, neighbours: int, seed: int) -> float:
    """Maximum-likelihood dimension of a random subsample of whitened latents; 1 for a single coordinate.

    The estimate depends on the scale of the neighbourhood: noise raises it, a coordinate that hardly moves
    lowers it. ``frames`` is the size of the sample, ``neighbours`` those of each frame.

    Raises:
        ValueError: fewer different frames than neighbours.

    Source: Levina and Bickel 2004; https://doi.org/10.3390/e23101368 (scikit-dimension).
    """
    if q.shape[1] == 1:
        return 1.0
    rng = np.random.default_rng(seed)
    # Equal frames, as at rest, have distance zero, whose logarithm does not exist.
    sample = np.unique(q[rng.choice(len(q), min(frames, len(q)), replace=False)], axis=0)
    if len(sample) <= neighbours:
        few = f"{len(sample)} different training frames are too few"
        raise ValueError(f"{few} for chart.dimension_neighbours={neighbours}: lower it")
    from skdim.id import MLE  # more than a second to import, which most jobs do without

    local = MLE().fit_transform_pw(sample, n_neighbors=neighbours)
    return float(1.0 / np.mean(1.0 / local[np.isfinite(local) & (local > 0)]))


@dataclass(frozen=True)
class Whitening:
    """``q = (z - mean) @ whiten`` and ``z = mean + q @ unwhiten``."""

    mean: Float64[np.ndarray, " d"]
    whiten: Float64[np.ndarray, "d d"]
    unwhiten: Float64[np.ndarray, "d d"]

    def to_raw(self, q: Series) -> Series:
        """Raw latents of whitened ones."""
        return self.mean + q @ self.unwhiten

    def to_whitened(self, z: Series) -> Series:
        """Whitened latents of raw ones."""
        return (z - self.mean) @ self.whiten


def fit_whitening(z: Series, *, eigenvalue_floor: float) -> Whitening:
    """Whiten by the principal axes of ``z``, the largest variance first.

    Rows are samples, so the factor on the right is ``V diag(l)^-1/2``, without transpose. The largest
    component of an axis is positive, so the same latents always give the same chart.

    Raises:
        ValueError: an axis has less than ``eigenvalue_floor`` of the largest variance, so that whitening
            would amplify its noise to the size of the motion.

    Source: paper, Implementation Details.
    """
    d, bad = z.shape[1], np.count_nonzero(~np.isfinite(z).all(1))
    if len(z) <= d or bad:
        raise ValueError(
            f"whitening needs more finite latents than dimensions; there are {len(z)} frames of d = {d}, "
            f"{bad} of them not finite: check stage 1"
        )
    mean = z.mean(0)
    variance, axes = np.linalg.eigh(np.atleast_2d(np.cov(z, rowvar=False)))
    variance, axes = variance[::-1].copy(), axes[:, ::-1]
    carried = variance > eigenvalue_floor * variance[0]
    if not carried.all() or variance[0] <= 0.0:
        listed, enough = ", ".join(f"{value:.3g}" for value in variance), np.count_nonzero(carried)
        raise ValueError(
            f"d = {d} is larger than the data can carry: the latent variances along their principal axes are "
            f"{listed}, and only {enough} exceed {eigenvalue_floor:g} of the largest. Set "
            f"system.d={max(1, enough)}, or train stage 1 longer"
        )
    axes = axes * np.sign(axes[np.abs(axes).argmax(0), np.arange(len(mean))])
    scale = np.sqrt(variance)
    return Whitening(mean=mean, whiten=axes / scale, unwhiten=(axes * scale).T.copy())
