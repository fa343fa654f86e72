"""Planar Gaussians that a network of the latent moves and reshapes: the other way to make pictures follow."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from lagsplat.shapes import Latents
from lagsplat.splat.gaussians import Slice


class DeformedGaussians(nn.Module):
    """``K`` planar Gaussians whose centres and shapes are free functions of the latent.

    One network takes the latent, in units of its spread, to a shift of every centre and a change of every
    factor of a covariance, all zero before training and softly limited: shifts to ``shift_limit`` [px],
    changes of shape to ``shape_limit``. Colours and opacities do not change. Lengths are in pixels.

    Source: paper, Appendix "Deformation-Field Decoder at Equal Budget"; Wu et al. 2024, arXiv:2310.08528.
    """

    latent_mean: Tensor
    latent_spread: Tensor

    def __init__(self, n: int, d: int, *, hidden: int, shift_limit: float, shape_limit: float) -> None:
        super().__init__()
        self.shift_limit, self.shape_limit = shift_limit, shape_limit
        self.center = nn.Parameter(torch.zeros(n, 2))
        self.shape_log_diagonal = nn.Parameter(torch.zeros(n, 2))
        self.shape_below = nn.Parameter(torch.zeros(n, 1))
        self.opacity_logit = nn.Parameter(torch.zeros(n))
        self.color_logit = nn.Parameter(torch.zeros(n, 3))
        self.background_logit = nn.Parameter(torch.zeros(3))
        self.trunk = nn.Sequential(nn.Linear(d, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU())
        self.head = nn.Linear(hidden, 5 * n)
        nn.init.zeros_(self.head.weight)
        nn.init.zeros_(self.head.bias)
        self.register_buffer("latent_mean", torch.zeros(d))
        self.register_buffer("latent_spread", torch.ones(d))

    def centers(self, z: Latents) -> Float[Tensor, "B K 2"]:
        """Centres at each latent [px]."""
        return self.center + self._moved(z)[0]

    def slices(self, z: Latents) -> list[Slice]:
        """The planar Gaussians at each latent: their shapes differ, so each is a scene of its own."""
        shifts, changes = self._moved(z)
        opacity, color = torch.sigmoid(self.opacity_logit)[None], torch.sigmoid(self.color_logit)
        found = []
        for shift, change in zip(shifts, changes, strict=True):
            a, c = (self.shape_log_diagonal + change[:, :2]).exp().unbind(1)
            b = self.shape_below[:, 0] + change[:, 2]
            covariance = torch.stack((a * a, a * b, b * b + c * c), dim=1)
            background = torch.sigmoid(self.background_logit)
            found.append(Slice((self.center + shift)[None], covariance, opacity, color, background))
        return found

    def jacobian(self, z: Float[Tensor, " d"]) -> Float[Tensor, "K 2 d"]:
        """How each centre follows the latent at ``z`` [px per unit of z]."""
        columns = [
            torch.func.jvp(lambda x: self.centers(x[None])[0], (z,), (along,))[1]
            for along in torch.eye(len(z), dtype=z.dtype, device=z.device)
        ]
        return torch.stack(columns, dim=-1).detach()

    def _moved(self, z: Latents) -> tuple[Float[Tensor, "B K 2"], Float[Tensor, "B K 3"]]:
        told = (z - self.latent_mean) / self.latent_spread
        out = self.head(self.trunk(told)).unflatten(1, (-1, 5))
        shift = self.shift_limit * torch.tanh(out[..., :2] / self.shift_limit)
        return shift, self.shape_limit * torch.tanh(out[..., 2:] / self.shape_limit)
