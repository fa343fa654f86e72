"""What the mass of a law is expected to be: that of the matter which is seen to move.

Free motion tells the ratio of stiffness to mass in each mode, and slow driven motion that of stiffness to
input. Neither tells how the energies of two modes compare. The mass that equally heavy matter induces,
``sum J^T J`` over its material points, compares them, up to hidden masses.
"""

import math

import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.functional import jacobian

from lagsplat.stage2.likelihood.parameter_vector import ParameterVector

MASS = "mass_term.factor"
WITHIN, NORMAL_90 = 2.0, 1.645
DEVIATION = math.log(WITHIN) / NORMAL_90
"""Of the logarithm of a ratio of masses: nine in ten are within a factor of two of the expected one."""


class MassPrior:
    """Expects the mass at the mean state to be ``expected``, but for one factor.

    Args:
        parameters: of the law, whose map and frame are the identity at the mean state.
        expected: mass that matter induces there [any unit].

    Source: paper eq. (latent-metric), "we take the density to be uniform".
    """

    def __init__(self, parameters: ParameterVector, expected: Float[Tensor, "d d"]) -> None:
        self.columns, self.floor = parameters.find_columns(MASS), parameters.terms[1].floor
        self.whiten = torch.linalg.inv(torch.linalg.cholesky(expected))

    def measure(self, theta: Float[Tensor, " p"]) -> tuple[Float[Tensor, " n"], Float[Tensor, "n p"]]:
        """Residuals of unit size, and their derivatives by ``theta``."""
        factor = theta[self.columns]
        rows = theta.new_zeros(2 * len(factor), len(theta))
        rows[:, self.columns] = jacobian(self._compare, factor)
        return self._compare(factor), rows

    def _compare(self, factor: Float[Tensor, " f"]) -> Float[Tensor, " n"]:
        """The mass, and its inverse, over what is expected, less their means, in deviations.

        Both together count a ratio and its reciprocal alike, and are smooth where ratios are equal.
        """
        d = len(self.whiten)
        lower = torch.tril(factor.view(d, d))
        eye = torch.eye(d, dtype=factor.dtype)
        ratio = self.whiten @ (lower @ lower.T + self.floor * eye) @ self.whiten.T
        parts = [each / (each.trace() / d) - eye for each in (ratio, torch.linalg.inv(ratio))]
        return torch.stack(parts).flatten() / (math.sqrt(2.0) * DEVIATION)
