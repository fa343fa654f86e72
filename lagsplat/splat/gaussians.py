"""The (n+d)-dimensional Gaussians of space and latent state, and their slice at a latent."""

from functools import reduce
from operator import add
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from lagsplat.array_types import Latents


class GaussianSlice(NamedTuple):
    """Gaussians of the plane, ready to draw, or of space, ready to project.

    A batch shares shapes and colours, not centres; after projection each image has its own (S = B).
    ``covariance`` holds the lower triangle row by row: xx, xy, yy and, in space, xz, yz, zz [px^2].
    """

    means: Float[Tensor, "B K n"]  # [px]
    covariance: Float[Tensor, "*S K m"]
    opacity: Float[Tensor, "B K"]
    color: Float[Tensor, "*S K 3"]
    background: Float[Tensor, "3"]


class Gaussians(nn.Module):
    """``K`` Gaussians in space and state, each with a fixed centre and covariance, an opacity and a colour.

    ``space`` is the number n of spatial dimensions: 2 for the image plane, 3 for several cameras.

    The covariance is ``Sigma = L L^T`` with ``L`` lower triangular in the order latent, space::

        L = [[P^-1, 0],        Sigma_zz = P^-1 P^-T
             [B,    S]]        Sigma_sz = B P^-T          Sigma_ss = B B^T + S S^T

    In this order the Schur complement needs no inverse: with ``w = P (z - center_z)`` the slice at ``z`` has
    mean ``center + B w``, covariance ``S S^T`` and gate ``exp(-w.w / 2)``, so the Jacobian of the mean is
    ``J = B P``. Lengths are in pixels of the training image; in space the unit is what a pixel of the
    reference camera covers at its pivot, see `lagsplat.views.camera`.

    Source: paper eqs. (schur-mean), (schur-cov), (latent_opacity).

    Example:
        >>> import lagsplat
        >>> lagsplat.Gaussians(100, d=2).n
        100
    """

    def __init__(self, n: int, d: int, *, space: int = 2, background: str = "learned") -> None:
        super().__init__()
        self.center = nn.Parameter(torch.zeros(n, space))
        self.latent_center = nn.Parameter(torch.zeros(n, d))
        self.precision_log_diagonal = nn.Parameter(torch.zeros(n, d))
        self.precision_below = nn.Parameter(torch.zeros(n, d * (d - 1) // 2))
        self.coupling = nn.Parameter(torch.zeros(n, space, d))
        self.shape_log_diagonal = nn.Parameter(torch.zeros(n, space))
        self.shape_below = nn.Parameter(torch.zeros(n, space * (space - 1) // 2))
        self.opacity_logit = nn.Parameter(torch.zeros(n))
        self.color_logit = nn.Parameter(torch.zeros(n, 3))
        self.background_logit = nn.Parameter(torch.zeros(3)) if background == "learned" else None

    @property
    def n(self) -> int:
        """Number of Gaussians ``K``."""
        return len(self.center)

    @property
    def d(self) -> int:
        """Dimension of the latent."""
        return self.latent_center.shape[1]

    @property
    def space(self) -> int:
        """Number of spatial dimensions."""
        return self.center.shape[1]

    def precision_factor(self) -> Float[Tensor, "K d d"]:
        """``P``, lower triangular with a positive diagonal: ``Sigma_zz^-1 = P^T P``."""
        return _lower(self.precision_log_diagonal, self.precision_below)

    def shape_factor(self) -> Float[Tensor, "K n n"]:
        """``S``, lower triangular with a positive diagonal [px]."""
        return _lower(self.shape_log_diagonal, self.shape_below)

    def jacobian(self) -> Float[Tensor, "K n d"]:
        """``J``, the derivative of each drawn centre by the latent [px per unit of z]; constant."""
        return self.coupling @ self.precision_factor()

    def gate(self, z: Latents) -> Float[Tensor, "B K"]:
        """Factor of each Gaussian's opacity at ``z``, in (0, 1]."""
        factor = self.precision_factor()
        offset = (factor @ self.latent_center[..., None]).flatten()
        whitened = torch.addmm(-offset, z, factor.flatten(0, 1).T).unflatten(1, (self.n, self.d))
        return torch.exp(-0.5 * whitened.square().sum(-1))

    def covariance(self) -> Float[Tensor, "K m"]:
        """Drawn covariance ``S S^T``, lower triangle row by row [px^2]; independent of the latent."""
        diagonal, below = self.shape_log_diagonal.exp().unbind(1), self.shape_below.unbind(1)
        rows = [[*below[i * (i - 1) // 2 :][:i], diagonal[i]] for i in range(self.space)]
        entries = [
            reduce(add, (a * b for a, b in zip(rows[i], rows[j], strict=False)))
            for i in range(self.space)
            for j in range(i + 1)
        ]
        return torch.stack(entries, dim=1)

    def background(self) -> Float[Tensor, "3"]:
        """Background colour: one learned colour, or black."""
        return self.center.new_zeros(3) if self.background_logit is None else self.background_logit.sigmoid()

    def condition(self, z: Latents) -> GaussianSlice:
        """Slice the Gaussians at each latent of the batch."""
        jacobian = self.jacobian()
        rest = self.center - (jacobian @ self.latent_center[..., None])[..., 0]
        return GaussianSlice(
            means=torch.addmm(rest.flatten(), z, jacobian.flatten(0, 1).T).unflatten(1, (self.n, self.space)),
            covariance=self.covariance(),
            opacity=torch.sigmoid(self.opacity_logit) * self.gate(z),
            color=torch.sigmoid(self.color_logit),
            background=self.background(),
        )


def _lower(log_diagonal: Float[Tensor, "K m"], below: Float[Tensor, "K _"]) -> Float[Tensor, "K m m"]:
    """Lower triangular matrices from their log diagonals and, row by row, the entries below."""
    count, size = log_diagonal.shape
    row, column = torch.tril_indices(size, size, offset=-1)
    factor = torch.diag_embed(log_diagonal.exp())
    return factor.index_put((torch.arange(count)[:, None], row, column), below)
