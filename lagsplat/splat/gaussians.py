"""The (2+d)-dimensional Gaussians that tile the space--state volume, and their slice at a latent."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from lagsplat.shapes import Latents


class Slice(NamedTuple):
    """Planar Gaussians, ready to be drawn: a batch shares their shapes and colours, not their places."""

    means: Float[Tensor, "B K 2"]  # [px]
    covariance: Float[Tensor, "K 3"]  # xx, xy, yy [px^2]
    opacity: Float[Tensor, "B K"]
    color: Float[Tensor, "K 3"]
    background: Float[Tensor, "3"]


class Gaussians(nn.Module):
    """``K`` Gaussians in (x, y, z), each with a fixed centre and covariance, an opacity and a colour.

    The covariance is ``Sigma = L L^T`` with ``L`` lower triangular in the order latent, space::

        L = [[P^-1, 0],        Sigma_zz = P^-1 P^-T
             [B,    S]]        Sigma_sz = B P^-T          Sigma_ss = B B^T + S S^T

    In this order the Schur complement needs no inverse: with ``w = P (z - center_z)`` the slice at ``z`` has
    its mean at ``center + B w``, the covariance ``S S^T`` and the gate ``exp(-w.w / 2)``, so the Jacobian of
    the mean is ``J = B P``. Lengths are in pixels of the training image.

    Source: paper eqs. (schur-mean), (schur-cov), (latent_opacity).
    """

    def __init__(self, n: int, d: int, *, background: str = "learned") -> None:
        super().__init__()
        self.center = nn.Parameter(torch.zeros(n, 2))
        self.latent_center = nn.Parameter(torch.zeros(n, d))
        self.precision_log_diagonal = nn.Parameter(torch.zeros(n, d))
        self.precision_below = nn.Parameter(torch.zeros(n, d * (d - 1) // 2))
        self.coupling = nn.Parameter(torch.zeros(n, 2, d))
        self.shape_log_diagonal = nn.Parameter(torch.zeros(n, 2))
        self.shape_below = nn.Parameter(torch.zeros(n))
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

    def precision_factor(self) -> Float[Tensor, "K d d"]:
        """``P``, lower triangular with a positive diagonal: ``Sigma_zz^-1 = P^T P``."""
        factor = torch.diag_embed(self.precision_log_diagonal.exp())
        row, column = torch.tril_indices(self.d, self.d, offset=-1)
        return factor.index_put((torch.arange(self.n)[:, None], row, column), self.precision_below)

    def jacobian(self) -> Float[Tensor, "K 2 d"]:
        """``J``, by which each drawn centre follows the latent [px per unit of z]; constant."""
        return self.coupling @ self.precision_factor()

    def gate(self, z: Latents) -> Float[Tensor, "B K"]:
        """Presence of each Gaussian at ``z``, in (0, 1]."""
        factor = self.precision_factor()
        offset = (factor @ self.latent_center[..., None]).flatten()
        whitened = torch.addmm(-offset, z, factor.flatten(0, 1).T).unflatten(1, (self.n, self.d))
        return torch.exp(-0.5 * whitened.square().sum(-1))

    def covariance(self) -> Float[Tensor, "K 3"]:
        """Drawn covariance ``S S^T`` as xx, xy, yy [px^2]; the same at every latent."""
        a, c = self.shape_log_diagonal.exp().unbind(1)
        b = self.shape_below
        return torch.stack((a * a, a * b, b * b + c * c), dim=1)

    def background(self) -> Float[Tensor, "3"]:
        """What is seen where nothing is drawn: one learned colour, or black."""
        return self.center.new_zeros(3) if self.background_logit is None else self.background_logit.sigmoid()

    def condition(self, z: Latents) -> Slice:
        """The planar Gaussians at each latent of the batch."""
        jacobian = self.jacobian()
        rest = self.center - (jacobian @ self.latent_center[..., None])[..., 0]
        return Slice(
            means=torch.addmm(rest.flatten(), z, jacobian.flatten(0, 1).T).unflatten(1, (self.n, 2)),
            covariance=self.covariance(),
            opacity=torch.sigmoid(self.opacity_logit) * self.gate(z),
            color=torch.sigmoid(self.color_logit),
            background=self.background(),
        )
