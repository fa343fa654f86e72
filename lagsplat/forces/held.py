"""A fitted run held at one operating point, ready to be pushed."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from lagsplat.chart.chart import Chart
from lagsplat.forces.equilibrium import settle
from lagsplat.forces.grip import Grip
from lagsplat.forces.kinematics import Kinematics, kinematics_of
from lagsplat.shapes import Latents
from lagsplat.splat.projection import View
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.stage2.lagrangian import Lagrangian

VISITED = 0.99
"""Quantile of the training states' distances from the rest: what lies further was hardly seen."""
MAGNITUDES = 60
SPAN = 1e4
STILL = 1e-6
"""Of the largest Jacobian: matter that moves less does not move."""


@dataclass(frozen=True)
class Held:
    """A law at rest under the constant inputs ``u`` (n_u,), in the state ``rest`` (d,); ``reach`` is how
    far training states lie from there, the 99th percentile [whitened units].
    """

    autoencoder: Autoencoder
    chart: Chart
    law: Lagrangian
    kinematics: Kinematics
    u: Float[Tensor, " n_u"]
    rest: Float[Tensor, " d"]
    reach: float

    def settled(self, loads: Float[Tensor, "B d"]) -> Latents:
        """Equilibria under generalised forces, one a row."""
        return settle(self.law, self.u.expand(len(loads), -1), loads, start=self.rest)

    def pictures(
        self, q: Latents, *, scale: int = 1, view: View | None = None
    ) -> Float[np.ndarray, "B H W 3"]:
        """Pictures at whitened states, ``scale`` times as large as in training; in space of any camera."""
        raw = torch.from_numpy(self.chart.to_raw(q.numpy())).to(self.autoencoder.gaussians.center)
        with torch.no_grad():
            drawn = self.autoencoder.decode(
                raw, view=view, height=scale * self.kinematics.height, width=scale * self.kinematics.width
            )
        return np.moveaxis(drawn.cpu().numpy(), 1, 3)

    def magnitude(self, grip: Grip, direction: Float64[np.ndarray, " n"], *, share: float) -> float:
        """The force along ``direction`` on ``grip`` that drives the state ``share`` of the reach away.

        In the law's own units of energy per pixel. Found among forces four decades apart at most, around what
        the stiffness at rest asks for, and interpolated.

        Raises:
            ValueError: the matter there does not move along ``direction``.
        """
        unit = grip.pull_back(torch.from_numpy(direction))
        if not float(unit.norm()) > STILL * float(self.kinematics.geometry.jacobian.abs().max()):
            raise ValueError(
                f"a force along {direction.tolist()} moves nothing at {grip.at.tolist()}: the matter there "
                "does not move that way; choose another point or direction"
            )
        small = 1e-3 * self.reach / float(unit.norm())
        answer = float((self.settled(small * unit[None])[0] - self.rest).norm())
        linear = share * self.reach * small / answer
        sizes = torch.from_numpy(np.geomspace(linear / np.sqrt(SPAN), linear * np.sqrt(SPAN), MAGNITUDES))
        away = (self.settled(sizes[:, None] * unit) - self.rest).norm(dim=1) / self.reach
        return float(np.exp(np.interp(np.log(share), away.log().numpy(), sizes.log().numpy())))


def hold(
    autoencoder: Autoencoder, chart: Chart, law: Lagrangian, u: Float64[np.ndarray, " n_u"] | None = None
) -> Held:
    """A run at rest under constant inputs: the mean of the training ones unless told otherwise."""
    inputs = torch.from_numpy(chart.train.inputs.mean(0) if u is None else u)
    rest = settle(law, inputs[None], torch.zeros(1, law.d, dtype=torch.float64))[0]
    away = np.linalg.norm(chart.train.latents - rest.numpy(), axis=1)
    reach = float(np.quantile(away, VISITED))
    return Held(autoencoder, chart, law, kinematics_of(autoencoder, chart), inputs, rest, reach)
