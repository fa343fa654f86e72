"""Polynomial terms of the Lagrangian: potential and input potentials, and matrix fields, of low degree.

All are polynomials of the soft-clipped state ``s``. Inside the data ``s`` is ``q``; far outside it is
bounded, and so are the terms and their slopes. A clip that began inside the data would bend a line: with
``s = 4 tanh(q / 4)`` a quartic of a linear spring is 1 to 2 % too stiff at rest.
"""

from itertools import combinations_with_replacement

import torch
from jaxtyping import Float
from torch import Tensor, nn

from lagsplat.array_types import Inputs, Latents, Spd
from lagsplat.stage2.networks import cholesky_solve, factor_positive

LINEAR_SHARE = 0.8  # of the soft limit, within which the clipped state is the state

Monomials = tuple[Float[Tensor, "B k"], Float[Tensor, "B k d"]]
"""Values and gradients of monomials at ``B`` states."""


def list_exponents(d: int, *, lowest: int, highest: int) -> Float[Tensor, "k d"]:
    """Exponents of all monomials of ``d`` variables of the degrees ``lowest`` to ``highest``, by degree."""
    rows = [
        [chosen.count(i) for i in range(d)]
        for degree in range(lowest, highest + 1)
        for chosen in combinations_with_replacement(range(d), degree)
    ]
    return torch.tensor(rows, dtype=torch.float64).reshape(-1, d)


def evaluate_monomials(q: Latents, exponents: Float[Tensor, "k d"], *, reach: float) -> Monomials:
    """Values and gradients at ``q`` of monomials of the state ``s`` that is clipped softly at ``reach``.

    ``s = q`` within a share `LINEAR_SHARE` of ``reach``, and a tanh beyond; two derivatives are continuous.

    Args:
        q: states [whitened units].
        exponents: powers of each coordinate, one row a monomial, from `list_exponents`.
        reach: soft limit of the states [whitened units].

    Example:
        >>> import torch
        >>> from lagsplat.stage2.polynomials import evaluate_monomials, list_exponents
        >>> exponents = list_exponents(1, lowest=1, highest=2)
        >>> value, slope = evaluate_monomials(torch.tensor([[0.1]]).double(), exponents, reach=100.0)
        >>> [round(float(x), 4) for x in (*value[0], *slope[0, :, 0])]
        [0.1, 0.01, 1.0, 0.2]
    """
    inside = q.clamp(-LINEAR_SHARE * reach, LINEAR_SHARE * reach)
    room = (1.0 - LINEAR_SHARE) * reach
    tanh = torch.tanh((q - inside) / room)
    s, ds = inside + room * tanh, 1.0 - tanh * tanh
    order = exponents.long()
    powers = [torch.ones_like(s)]
    for _ in range(int(order.max()) if order.numel() else 0):
        powers.append(powers[-1] * s)
    table = torch.stack(powers)
    d = q.shape[1]
    factors = [table[order[:, i], :, i] for i in range(d)]
    value = torch.ones_like(factors[0])
    for factor in factors:
        value = value * factor
    slopes = []
    for i in range(d):
        slope = exponents[:, i, None] * table[(order[:, i] - 1).clamp(min=0), :, i] * ds[:, i]
        for j in range(d):
            if j != i:
                slope = slope * factors[j]
        slopes.append(slope)
    return value.T, torch.stack(slopes, 2).permute(1, 0, 2)


class PolynomialEnergy(nn.Module):
    """``U(q, u) = ridge |q|^2 / 2 + V(s) - u.nu(s)`` with polynomials ``V`` and ``nu`` in their coefficients.

    ``ridge`` is the stiffness that is left far outside the data, where the polynomials are constant: every
    motion is bounded. Inside the data there may be several equilibria; nothing counts them.

    Args:
        d, n_inputs: coordinates and inputs.
        potential_degree, input_degree: degrees of ``V`` and of each ``nu``.
        reach: soft limit ``R`` of the states [whitened units].
        ridge: stiffness far outside the data.
    """

    exponents: Tensor
    input_exponents: Tensor
    ridge: Tensor

    def __init__(
        self, d: int, n_inputs: int, *, potential_degree: int, input_degree: int, reach: float, ridge: float
    ) -> None:
        super().__init__()
        self.reach = reach
        self.register_buffer("ridge", torch.tensor(ridge, dtype=torch.float64))
        exponents = list_exponents(d, lowest=1, highest=potential_degree)
        input_exponents = list_exponents(d, lowest=1, highest=input_degree)
        self.register_buffer("exponents", exponents, persistent=False)
        self.register_buffer("input_exponents", input_exponents, persistent=False)
        self.coefficients = nn.Parameter(torch.zeros(len(exponents), dtype=torch.float64))
        self.input_coefficients = nn.Parameter(
            torch.zeros(n_inputs, len(input_exponents), dtype=torch.float64)
        )

    def set_quadratic(
        self,
        stiffness: Float[Tensor, "d d"],
        rest: Float[Tensor, " d"],
        pressure_map: Float[Tensor, "n_u d"],
    ) -> None:
        """Set ``U = (q - rest).stiffness (q - rest) / 2 - u.pressure_map q``, as far as ``s`` is ``q``."""
        with torch.no_grad():
            self.coefficients.zero_()
            self.input_coefficients.zero_()
            curvature = stiffness - self.ridge * torch.eye(len(rest), dtype=rest.dtype)
            linear = -(stiffness @ rest)
            for k, powers in enumerate(self.exponents.long().tolist()):
                axes = [i for i, power in enumerate(powers) for _ in range(power)]
                if len(axes) == 1:
                    self.coefficients[k] = linear[axes[0]]
                    self.input_coefficients[:, k] = pressure_map[:, axes[0]]
                elif len(axes) == 2:
                    share = 0.5 if axes[0] == axes[1] else 1.0
                    self.coefficients[k] = share * curvature[axes[0], axes[1]]

    def potential(self, q: Latents) -> Float[Tensor, " B"]:
        """``ridge |q|^2 / 2 + V``, up to a constant."""
        value, _ = evaluate_monomials(q, self.exponents, reach=self.reach)
        return 0.5 * self.ridge * q.square().sum(1) + value @ self.coefficients

    def volume(self, q: Latents) -> Inputs:
        """``nu`` of each input, zero at ``q = 0``."""
        value, _ = evaluate_monomials(q, self.input_exponents, reach=self.reach)
        return value @ self.input_coefficients.T

    def slope(self, q: Latents, u: Inputs) -> Latents:
        """``grad_q U``."""
        _, gradient = evaluate_monomials(q, self.exponents, reach=self.reach)
        slope = self.ridge * q + torch.einsum("k,bkd->bd", self.coefficients, gradient)
        if u.shape[1]:
            _, gradient = evaluate_monomials(q, self.input_exponents, reach=self.reach)
            slope = slope - torch.einsum("bk,bkd->bd", u @ self.input_coefficients, gradient)
        return slope


class PolynomialField(nn.Module):
    """``S(q) = L0 E(q) E(q)^T L0^T + floor I``, ``E`` lower triangular and a polynomial that starts at ``I``.

    Positive definite for any coefficients; its degree is twice that of ``E``.
    """

    exponents: Tensor
    mask: Tensor

    def __init__(self, start: Float[Tensor, "d d"], *, floor: float, degree: int, reach: float) -> None:
        super().__init__()
        d = start.shape[0]
        exponents = list_exponents(d, lowest=1, highest=degree)
        self.register_buffer("exponents", exponents, persistent=False)
        self.register_buffer("mask", torch.tril(torch.ones(d, d, dtype=torch.float64)), persistent=False)
        self.factor = nn.Parameter(factor_positive(start, floor))
        self.coefficients = nn.Parameter(torch.zeros(len(exponents), d, d, dtype=torch.float64))
        self.floor, self.reach = floor, reach

    def _triangle(self, value: Float[Tensor, "B k"]) -> Spd:
        eye = torch.eye(self.mask.shape[0], dtype=value.dtype)
        return eye + torch.einsum("bk,kij->bij", value, self.coefficients * self.mask)

    def _square(self, whole: Spd) -> Spd:
        return whole @ whole.mT + self.floor * torch.eye(whole.shape[-1], dtype=whole.dtype)

    def matrix(self, q: Latents) -> Spd:
        """The matrix at ``q``."""
        value, _ = evaluate_monomials(q, self.exponents, reach=self.reach)
        return self._square(torch.tril(self.factor) @ self._triangle(value))

    def product(self, q: Latents, v: Latents) -> Latents:
        """``S(q) v``."""
        return (self.matrix(q) @ v[:, :, None])[:, :, 0]

    def accelerate(self, q: Latents, v: Latents, force: Latents) -> Latents:
        """``S^-1 (force + grad_q (v.S v / 2) - (dS/dt) v)``."""
        lower, coefficients = torch.tril(self.factor), self.coefficients * self.mask
        value, slope = evaluate_monomials(q, self.exponents, reach=self.reach)
        e = self._triangle(value)
        y = (v @ lower)[:, :, None]
        p = e.mT @ y
        rate = torch.einsum("bkd,bd,kij->bij", slope, v, coefficients)
        change = (rate @ p + e @ (rate.mT @ y))[:, :, 0] @ lower.T
        gradient = torch.einsum("bi,kij,bj,bkd->bd", y[:, :, 0], coefficients, p[:, :, 0], slope)
        return cholesky_solve(self._square(lower @ e), force + gradient - change)
