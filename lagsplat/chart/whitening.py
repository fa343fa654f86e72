"""PCA whitening of the latents, frozen on the training frames."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from lagsplat.shapes import Series


@dataclass(frozen=True)
class Whitening:
    """``q = (z - mean) @ whiten`` and ``z = mean + q @ unwhiten``; ``variance`` of each axis in raw units."""

    mean: Float64[np.ndarray, " d"]
    whiten: Float64[np.ndarray, "d d"]
    unwhiten: Float64[np.ndarray, "d d"]
    variance: Float64[np.ndarray, " d"]


def fit_whitening(z: Series, *, eigenvalue_floor: float) -> Whitening:
    """Whiten by the principal axes of ``z``, the largest variance first.

    Rows are samples, so that the factor on the right is ``V diag(l)^-1/2``, without transpose. The sign of
    an axis makes its largest component positive: the same latents always give the same chart.

    Raises:
        ValueError: an axis has less than ``eigenvalue_floor`` of the largest variance, so that whitening it
            would blow noise up to the size of the motion.

    Source: paper, Implementation Details.
    """
    if len(z) <= z.shape[1] or not np.isfinite(z).all():
        raise ValueError(
            f"whitening needs more finite latents than dimensions; there are {len(z)} frames of "
            f"d = {z.shape[1]}, {np.count_nonzero(~np.isfinite(z).all(1))} of them not finite: check stage 1"
        )
    mean = z.mean(0)
    variance, axes = np.linalg.eigh(np.atleast_2d(np.cov(z, rowvar=False)))
    variance, axes = variance[::-1].copy(), axes[:, ::-1]
    carried = variance > eigenvalue_floor * variance[0]
    if not carried.all() or variance[0] <= 0.0:
        listed = ", ".join(f"{value:.3g}" for value in variance)
        raise ValueError(
            f"d = {z.shape[1]} is larger than the data can carry: the latent variances along their "
            f"principal axes are {listed}, and only {np.count_nonzero(carried)} exceed {eigenvalue_floor:g} "
            "of the largest. "
            f"Set system.d={max(1, np.count_nonzero(carried))}, or train stage 1 longer"
        )
    axes = axes * np.sign(axes[np.abs(axes).argmax(0), np.arange(len(mean))])
    scale = np.sqrt(variance)
    return Whitening(mean=mean, whiten=axes / scale, unwhiten=(axes * scale).T.copy(), variance=variance)
