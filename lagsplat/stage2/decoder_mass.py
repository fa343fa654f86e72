"""The mass induced by the decoder's kinematics, where every visible Gaussian carries the same mass."""

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from lagsplat.array_types import Latents, Spd
from lagsplat.chart.chart import Chart
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.stage2.networks import cholesky_solve


@dataclass(frozen=True)
class DecoderGeometry:
    """Geometry of the decoder's Gaussians in whitened coordinates (float64).

    ``jacobian`` is the motion of each centre per unit latent [px], ``center`` its latent centre,
    ``precision_factor`` the ``F`` of the gate ``exp(-|F (q - center)|^2 / 2)``, ``opacity`` its base opacity.
    """

    jacobian: Float[Tensor, "K n d"]
    center: Float[Tensor, "K d"]
    precision_factor: Float[Tensor, "K d d"]
    opacity: Float[Tensor, " K"]


def compute_decoder_geometry(autoencoder: Autoencoder, chart: Chart) -> DecoderGeometry:
    """Compute the geometry of a decoder's Gaussians in the whitened coordinates of a chart.

    A raw column vector is ``unwhiten^T`` times the whitened one, hence the transpose on both maps.
    """
    gaussians = autoencoder.gaussians
    mean, whiten, unwhiten = (torch.from_numpy(x) for x in (chart.mean, chart.whiten, chart.unwhiten))
    with torch.no_grad():
        return DecoderGeometry(
            jacobian=gaussians.jacobian().cpu().double() @ unwhiten.T,
            center=(gaussians.latent_center.cpu().double() - mean) @ whiten,
            precision_factor=gaussians.precision_factor().cpu().double() @ unwhiten.T,
            opacity=gaussians.opacity_logit.cpu().double().sigmoid(),
        )


class InducedMass(nn.Module):
    """``M(q) = m sum_i w_i(q) J_i^T J_i + floor I``, ``w_i`` the presence ``alpha_i gate_i`` over its sum.

    The gates are exponentials of a quadratic in ``q``, so that all Gaussians cost one matrix product. The
    gradient of ``M`` follows from ``dw_i = w_i (g_i - mean g)`` with ``g_i = -P_i (q - center_i)``, which is
    another product with constant moments.

    Source: paper eq. (latent-metric) and Appendix, "The same map carries the inertia".
    """

    features: Tensor
    moments: Tensor
    scale: Tensor

    def __init__(self, geometry: DecoderGeometry, *, scale: float, floor: float) -> None:
        super().__init__()
        jacobian, center = geometry.jacobian, geometry.center
        k, _, d = jacobian.shape
        inertia = jacobian.mT @ jacobian
        precision = geometry.precision_factor.mT @ geometry.precision_factor
        pull = (precision @ center[:, :, None])[:, :, 0]
        constant = geometry.opacity.clamp(min=1e-12).log() - 0.5 * (center * pull).sum(1)
        self.register_buffer("features", torch.cat([-0.5 * precision.flatten(1), pull, constant[:, None]], 1))
        # the gradient of w_i is w_i (pull_i - precision_i q - mean): sums of these against each inertia
        moments = [
            inertia.flatten(1),
            pull,
            precision.flatten(1),
            (pull[:, :, None] * inertia.flatten(1)[:, None, :]).flatten(1),
            (precision.flatten(1)[:, :, None] * inertia.flatten(1)[:, None, :]).flatten(1),
        ]
        self.register_buffer("moments", torch.cat(moments, 1))
        self.register_buffer("scale", torch.tensor(scale, dtype=torch.float64))
        self.sizes = [m.shape[1] for m in moments]
        self.floor, self.d, self.n_primitives = floor, d, k

    def _presence(self, q: Latents) -> Float[Tensor, "B K"]:
        ones = q.new_ones(q.shape[0], 1)
        phi = torch.cat([(q[:, :, None] * q[:, None, :]).flatten(1), q, ones], 1)
        return torch.softmax(phi @ self.features.T, dim=1)

    def matrix(self, q: Latents) -> Spd:
        """The mass at ``q``."""
        d = self.d
        mass = (self._presence(q) @ self.moments[:, : d * d]).view(-1, d, d)
        return self.scale * mass + self.floor * torch.eye(d, dtype=q.dtype)

    def inertia(self, q: Latents, v: Latents) -> tuple[Spd, Latents]:
        """``M`` and the velocity forces ``grad_q (v.M v / 2) - (dM/dt) v``."""
        d = self.d
        sums = torch.split(self._presence(q) @ self.moments, self.sizes, dim=1)
        mass = sums[0].view(-1, d, d)
        score = sums[1] - (sums[2].view(-1, d, d) @ q[:, :, None])[:, :, 0]
        slope = sums[3].view(-1, d, d * d) - torch.einsum("bakm,bk->bam", sums[4].view(-1, d, d, d * d), q)
        slope = slope.view(-1, d, d, d) - score[:, :, None, None] * mass[:, None]
        # slope[b, a] is dM/dq_a over the scale
        along = (slope @ v[:, None, :, None])[:, :, :, 0]
        gradient = 0.5 * (along @ v[:, :, None])[:, :, 0]
        change = (along * v[:, :, None]).sum(1)
        whole = self.scale * mass + self.floor * torch.eye(d, dtype=q.dtype)
        return whole, self.scale * (gradient - change)

    def accelerate(self, q: Latents, v: Latents, force: Latents) -> Latents:
        """``M^-1 (force + velocity forces)``."""
        mass, velocity_force = self.inertia(q, v)
        return cholesky_solve(mass, force + velocity_force)
