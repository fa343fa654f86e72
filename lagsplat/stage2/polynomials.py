"""Polynomial terms of the Lagrangian: potential and input potentials, and matrix fields, of low degree.

All are polynomials of the soft-clipped state ``s``. Inside the data ``s`` is ``q``; far outside it is
bounded, and so are the terms and their slopes. A clip that began inside the data would bend a line: with
``s = 4 tanh(q / 4)`` a quartic of a linear spring is 1 to 2 % too stiff at rest.
"""

from collections.abc import Sequence
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
    levels, (first, _) = _raise_powers(q, exponents, reach=reach)
    order, d = exponents.long(), q.shape[1]
    factors = [levels[order[:, i], i] for i in range(d)]
    value = torch.ones((len(exponents), len(q)), dtype=q.dtype)
    for factor in factors:
        value = value * factor
    slopes = []
    for i in range(d):
        slope = exponents[:, i, None] * levels[(order[:, i] - 1).clamp(min=0), i] * first[i]
        for j in range(d):
            if j != i:
                slope = slope * factors[j]
        slopes.append(slope)
    return value.T, torch.stack(slopes, 2).permute(1, 0, 2)


def differentiate_monomials(
    q: Latents, exponents: Float[Tensor, "k d"], *, reach: float
) -> tuple[Float[Tensor, "B k"], Float[Tensor, "B k d"], Float[Tensor, "B k d d"]]:
    """Values, gradients and second derivatives of `evaluate_monomials`."""
    levels, (first, second) = _raise_powers(q, exponents, reach=reach)
    order, d = exponents.long(), q.shape[1]
    rows = []  # value, first and second derivative of the power of each coordinate
    for i in range(d):
        power = exponents[:, i, None]
        lower, lowest = (levels[(order[:, i] - n).clamp(min=0), i] for n in (1, 2))
        by_s = power * lower
        rows.append(
            (
                levels[order[:, i], i],
                by_s * first[i],
                power * (power - 1.0) * lowest * first[i] ** 2 + by_s * second[i],
            )
        )
    one = torch.ones((len(exponents), len(q)), dtype=q.dtype)

    def multiply(orders: Sequence[int]) -> Float[Tensor, "k B"]:
        product = one
        for row, derivative in zip(rows, orders, strict=True):
            product = product * row[derivative]
        return product

    at = range(d)
    value = multiply([0] * d)
    slope = [multiply([int(i == m) for m in at]) for i in at]
    bend = [multiply([int(i == m) + int(j == m) for m in at]) for i in at for j in at]
    stacked = torch.stack(bend, 2).reshape(len(exponents), len(q), d, d)
    return value.T, torch.stack(slope, 2).permute(1, 0, 2), stacked.permute(1, 0, 2, 3)


def _raise_powers(
    q: Latents, exponents: Float[Tensor, "k d"], *, reach: float
) -> tuple[Float[Tensor, "n d B"], tuple[Float[Tensor, "d B"], Float[Tensor, "d B"]]]:
    """Powers of the clipped state, and its first and second derivative by the state."""
    q = q.T
    inside = q.clamp(-LINEAR_SHARE * reach, LINEAR_SHARE * reach)
    room = (1.0 - LINEAR_SHARE) * reach
    tanh = torch.tanh((q - inside) / room)
    s, first = inside + room * tanh, 1.0 - tanh * tanh
    powers = [torch.ones_like(s)]
    for _ in range(int(exponents.max()) if exponents.numel() else 0):
        powers.append(powers[-1] * s)
    return torch.stack(powers), (first, -2.0 / room * tanh * first)


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


class PolynomialFrame(nn.Module):
    """``J(q) = I + sum_k m_k(s) J_k``, the frame in which mass and damping of a law are constant.

    In coordinates that bend, constant matrices of the mechanism become ``J^T M_0 J`` and ``J^T C_0 J`` with
    one ``J``, so that mass and damping share it.

    Args:
        d: coordinates.
        degree: of the polynomials; 0 leaves ``J = I``.
        reach: soft limit of the states [whitened units].
    """

    exponents: Tensor

    def __init__(self, d: int, *, degree: int, reach: float) -> None:
        super().__init__()
        self.d, self.reach = d, reach
        exponents = list_exponents(d, lowest=1, highest=degree)
        self.register_buffer("exponents", exponents, persistent=False)
        self.coefficients = nn.Parameter(torch.zeros(len(exponents), d, d, dtype=torch.float64))

    def evaluate(self, q: Latents) -> tuple[Float[Tensor, "B d d"], Float[Tensor, "B d d d"]]:
        """``J`` and its derivatives by each coordinate, the last axis."""
        value, slope = evaluate_monomials(q, self.exponents, reach=self.reach)
        frame = torch.eye(self.d, dtype=q.dtype) + torch.einsum("bk,kij->bij", value, self.coefficients)
        return frame, torch.einsum("bkl,kij->bijl", slope, self.coefficients)


class PolynomialField(nn.Module):
    """``S(q) = J(q)^T S_0 J(q) + floor I``, positive definite for any coefficients.

    Args:
        start: ``S`` where ``J = I``.
        floor: lower bound of the eigenvalues.
        frame: ``J``, shared by mass and damping.
    """

    def __init__(self, start: Float[Tensor, "d d"], *, floor: float, frame: PolynomialFrame) -> None:
        super().__init__()
        self.factor = nn.Parameter(factor_positive(start, floor))
        self.frame, self.floor = frame, floor

    def inner(self) -> Float[Tensor, "d d"]:
        """``S_0``."""
        lower = torch.tril(self.factor)
        return lower @ lower.T

    def matrix(self, q: Latents) -> Spd:
        """The matrix at ``q``."""
        frame, _ = self.frame.evaluate(q)
        return frame.mT @ self.inner() @ frame + self.floor * torch.eye(q.shape[1], dtype=q.dtype)

    def product(self, q: Latents, v: Latents) -> Latents:
        """``S(q) v``."""
        return (self.matrix(q) @ v[:, :, None])[:, :, 0]

    def accelerate(self, q: Latents, v: Latents, force: Latents) -> Latents:
        """``S^-1 (force + grad_q (v.S v / 2) - (dS/dt) v)``."""
        (frame, slope), inner = self.frame.evaluate(q), self.inner()
        moved = torch.einsum("bijl,bj->bil", slope, v)
        turning = moved - torch.einsum("bijl,bl->bij", slope, v)
        change = (frame.mT @ inner @ moved - turning.mT @ inner @ frame) @ v[:, :, None]
        matrix = frame.mT @ inner @ frame + self.floor * torch.eye(q.shape[1], dtype=q.dtype)
        return cholesky_solve(matrix, force - change[:, :, 0])


class ForceBalance:
    """Balance of forces of a polynomial law at some states, with its derivatives in closed form.

    With ``w = J v``, ``A_il = sum_j dJ_ij/dq_l v_j`` and ``e = J a + A v`` it is
    ``J^T (M_0 e + C_0 w) + floors - (A - dJ/dt)^T M_0 w + grad U = 0``. Automatic differentiation takes
    seven times as long.

    Args:
        energy, mass, damping: terms of the law.
        state: positions and velocities (B, 2 d).
        u: inputs (B, n_u).
    """

    def __init__(
        self,
        energy: PolynomialEnergy,
        mass: PolynomialField,
        damping: PolynomialField,
        state: Float[Tensor, "B s"],
        u: Inputs,
    ) -> None:
        self.energy, self.mass, self.damping, self.u = energy, mass, damping, u
        d, frame = mass.frame.d, mass.frame
        q, self.v = state[:, :d], state[:, d:]
        self.eye = torch.eye(d, dtype=q.dtype)
        self.elastic = differentiate_monomials(q, energy.exponents, reach=energy.reach)
        self.pushed = differentiate_monomials(q, energy.input_exponents, reach=energy.reach)
        self.shape = differentiate_monomials(q, frame.exponents, reach=frame.reach)
        value, first, _ = self.shape
        self.frame = self.eye + torch.einsum("bk,kij->bij", value, frame.coefficients)
        self.frame_by_q = torch.einsum("bkl,kij->bijl", first, frame.coefficients)
        inertia, viscosity = mass.inner(), damping.inner()
        self.moved = torch.einsum("bijl,bj->bil", self.frame_by_q, self.v)  # A
        self.rate = torch.einsum("bijl,bl->bij", self.frame_by_q, self.v)  # dJ/dt
        self.turning = self.moved - self.rate
        self.w = torch.einsum("bij,bj->bi", self.frame, self.v)
        self.z = self.w @ inertia
        self.carried, self.turned = self.frame.mT @ inertia, self.turning.mT @ inertia
        self.resisted = self.frame.mT @ viscosity
        self.inverse_mass = torch.linalg.inv(self.carried @ self.frame + mass.floor * self.eye)
        bent = torch.einsum("bil,bl->bi", self.moved, self.v)
        loads = (u @ energy.input_coefficients)[:, None]
        slope = energy.ridge * q + energy.coefficients @ self.elastic[1] - (loads @ self.pushed[1])[:, 0]
        viscous = torch.einsum("bli,bi->bl", self.resisted - self.turned, self.w) + damping.floor * self.v
        inertial = torch.einsum("bli,bi->bl", self.carried, bent)
        self.acceleration = (self.inverse_mass @ (-slope - viscous - inertial)[:, :, None])[:, :, 0]
        self.e = torch.einsum("bij,bj->bi", self.frame, self.acceleration) + bent
        self.force = self.e @ inertia + self.w @ viscosity

    def differentiate_by_state(self) -> tuple[Float[Tensor, "B d d"], Float[Tensor, "B d d"]]:
        """Derivatives of the acceleration by position and by velocity."""
        energy, v, z, shapes = self.energy, self.v, self.z, self.mass.frame.coefficients
        second, drag = self.shape[2], self.resisted - self.turned
        by_v = self.carried @ (self.rate + self.moved) + drag @ self.frame + self.damping.floor * self.eye
        by_v = by_v - torch.einsum("bi,bipl->blp", z, self.frame_by_q - self.frame_by_q.mT)
        spread = torch.einsum("kij,bj->bki", shapes, v)
        swept = torch.einsum("bklp,bl->bkp", second, v)  # of dm_k/dt
        e_by_q = torch.einsum("bijp,bj->bip", self.frame_by_q, self.acceleration)
        e_by_q = e_by_q + torch.einsum("bki,bkp->bip", spread, swept)
        by_q = self.carried @ e_by_q + drag @ self.moved + energy.ridge * self.eye
        by_q = by_q + torch.einsum("bilp,bi->blp", self.frame_by_q, self.force)
        by_q = by_q - torch.einsum("bki,bi,bklp->blp", spread, z, second)
        by_q = by_q + torch.einsum("kil,bi,bkp->blp", shapes, z, swept)
        by_q = by_q + torch.einsum("k,bkil->bil", energy.coefficients, self.elastic[2])
        by_q = by_q - torch.einsum("bk,bkil->bil", self.u @ energy.input_coefficients, self.pushed[2])
        return -self.inverse_mass @ by_q, -self.inverse_mass @ by_v

    def differentiate_by_parameters(self) -> dict[str, Float[Tensor, "B d _"]]:
        """Derivatives of ``M a`` less all forces, at a fixed ``a``, by each parameter of the law.

        The acceleration changes by ``-inverse_mass`` times them. Keys are names in
        `lagsplat.stage2.lagrangian.Lagrangian`.
        """
        (value, first, _), a, v, w, z = self.shape, self.acceleration, self.v, self.w, self.z
        heavy, light = torch.tril(self.mass.factor), torch.tril(self.damping.factor)

        def vary_factor(factor: Tensor, side: Tensor, x: Latents) -> Float[Tensor, "B d d d"]:
            """Derivatives of ``side^T L L^T x`` by ``L``."""
            by_inner = torch.einsum("bal,bc->blac", side, x @ factor)
            return by_inner + torch.einsum("blc,ba->blac", side.mT @ factor, x)

        by_mass = vary_factor(heavy, self.frame, self.e) - vary_factor(heavy, self.turning, w)
        by_damping = vary_factor(light, self.frame, w)
        swift = torch.einsum("bkl,bl->bk", first, v)[:, :, None]  # dm_k/dt
        moved = value[:, :, None] * a[:, None] + swift * v[:, None]
        by_frame = torch.einsum("bli,bkj->blkij", self.carried, moved)
        by_frame = by_frame + torch.einsum("bli,bk,bj->blkij", self.resisted - self.turned, value, v)
        by_frame = by_frame - torch.einsum("bj,bkl,bi->blkij", v, first, z)
        own = value[:, :, None] * self.force[:, None] + swift * z[:, None]
        by_frame = by_frame + torch.einsum("lj,bki->blkij", self.eye, own)
        by_input = -torch.einsum("bc,bkl->blck", self.u, self.pushed[1])
        inside = torch.tril(torch.ones_like(self.eye))
        return {
            "energy.coefficients": self.elastic[1].mT,
            "energy.input_coefficients": by_input.flatten(2),
            "mass_term.factor": (by_mass * inside).flatten(2),
            "damping_term.factor": (by_damping * inside).flatten(2),
            "mass_term.frame.coefficients": by_frame.flatten(2),
        }
