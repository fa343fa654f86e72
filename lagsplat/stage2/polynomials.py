"""Polynomial terms of the Lagrangian: potential and input potentials, and matrix fields, of low degree.

Terms of high degree are polynomials of the state that is clipped softly outside the data, see
`lagsplat.monomials`. Springs and constant forces are never clipped: outside the data a law is a linear one,
more or less.
"""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from lagsplat.array_types import Inputs, Latents, Spd
from lagsplat.monomials import (
    ROOM,
    Ball,
    differentiate_monomials,
    draw_states,
    evaluate_monomials,
    list_exponents,
    make_wide_ball,
)
from lagsplat.stage2 import polynomial_kernels
from lagsplat.stage2.networks import cholesky_solve, factor_positive

NEWTON_STEPS, LONGEST_NEWTON_STEP, ARRIVED = 40, 0.5, 1e-12  # [-, whitened units, whitened units]
# The numbers below were set by hand, with both simulated arms and the toy in view.
SPRINGS, LOADS = 2, 1  # degrees up to which V and nu are polynomials of the state itself
CHECKED, REACH = 8192, 2.0  # points at which a map must be invertible, and how many radii off they are


class PolynomialEnergy(nn.Module):
    """``U(q, u) = V - u.nu`` with polynomials ``V`` and ``nu`` in their coefficients.

    Quadratic ``V`` and linear ``nu`` are polynomials of the state, and what is of a higher degree of the
    clipped state. So far outside the data a spring prevails, and where that is stable
    (`measure_far_stiffness`) every motion is bounded under any input.
    `lagsplat.stage2.equilibrium.list_stable_equilibria` finds the equilibria inside.

    Args:
        d, n_inputs: coordinates and inputs.
        potential_degree, input_degree: degrees of ``V`` and of each ``nu``.
        ball: where ``s = q`` [whitened units].
    """

    exponents: Tensor
    input_exponents: Tensor
    ball: Tensor

    def __init__(
        self,
        d: int,
        n_inputs: int,
        *,
        potential_degree: int,
        input_degree: int,
        ball: Ball,
    ) -> None:
        super().__init__()
        self.register_buffer("ball", ball.clone())
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
        """Set ``U = (q - rest).stiffness (q - rest) / 2 - u.pressure_map q``."""
        with torch.no_grad():
            self.coefficients.zero_()
            self.input_coefficients.zero_()
            linear = -(stiffness @ rest)
            for k, powers in enumerate(self.exponents.long().tolist()):
                axes = [i for i, power in enumerate(powers) for _ in range(power)]
                if len(axes) == 1:
                    self.coefficients[k] = linear[axes[0]]
                    self.input_coefficients[:, k] = pressure_map[:, axes[0]]
                elif len(axes) == 2:
                    share = 0.5 if axes[0] == axes[1] else 1.0
                    self.coefficients[k] = share * stiffness[axes[0], axes[1]]

    def potential(self, q: Latents) -> Float[Tensor, " B"]:
        """``V``, up to a constant."""
        value, _ = evaluate_monomials(q, self.exponents, ball=self.ball, free_degree=SPRINGS)
        return value @ self.coefficients

    def volume(self, q: Latents) -> Inputs:
        """``nu`` of each input, zero at ``q = 0``."""
        value, _ = evaluate_monomials(q, self.input_exponents, ball=self.ball, free_degree=LOADS)
        return value @ self.input_coefficients.T

    def slope(self, q: Latents, u: Inputs) -> Latents:
        """``grad_q U``."""
        _, gradient = evaluate_monomials(q, self.exponents, ball=self.ball, free_degree=SPRINGS)
        slope = torch.einsum("k,bkd->bd", self.coefficients, gradient)
        if u.shape[1]:
            _, gradient = evaluate_monomials(q, self.input_exponents, ball=self.ball, free_degree=LOADS)
            slope = slope - torch.einsum("bk,bkd->bd", u @ self.input_coefficients, gradient)
        return slope

    def differentiate(self, q: Latents, u: Inputs) -> tuple[Latents, Float[Tensor, "B d d"]]:
        """Slope and stiffness of ``U``."""
        (elastic, elastic_bend), (pushed, pushed_bend) = self.differentiate_terms(q)
        loads = u @ self.input_coefficients
        slope = self.coefficients @ elastic - (loads[:, None] @ pushed)[:, 0]
        stiffness = torch.einsum("k,bkil->bil", self.coefficients, elastic_bend)
        return slope, stiffness - torch.einsum("bk,bkil->bil", loads, pushed_bend)

    def differentiate_terms(
        self, q: Latents
    ) -> tuple[
        tuple[Float[Tensor, "B k d"], Float[Tensor, "B k d d"]],
        tuple[Float[Tensor, "B m d"], Float[Tensor, "B m d d"]],
    ]:
        """Gradients and second derivatives of the monomials of ``V``, and of those of ``nu``."""
        _, *elastic = differentiate_monomials(q, self.exponents, ball=self.ball, free_degree=SPRINGS)
        _, *pushed = differentiate_monomials(q, self.input_exponents, ball=self.ball, free_degree=LOADS)
        return (elastic[0], elastic[1]), (pushed[0], pushed[1])

    @torch.no_grad()
    def measure_far_stiffness(self) -> float:
        """Smallest stiffness of the spring that is left far outside; if positive, motions are bounded."""
        squares = (self.exponents.sum(1) == SPRINGS).double() * self.coefficients
        origin = self.coefficients.new_zeros(1, self.exponents.shape[1])
        wide = make_wide_ball(self.exponents.shape[1])
        bends = differentiate_monomials(origin, self.exponents, ball=wide)[2][0]
        return float(torch.linalg.eigvalsh(torch.einsum("k,kij->ij", squares, bends))[0])


class PolynomialSum(nn.Module):
    """Monomials with a vector or matrix of coefficients each, which start at zero.

    Args:
        ball: where ``s = q`` [whitened units].
        shape: of the coefficients of a monomial; its last size is the number of coordinates.
        lowest, highest: degrees of the monomials.
    """

    exponents: Tensor
    ball: Tensor

    def __init__(self, ball: Ball, shape: tuple[int, ...], *, lowest: int, highest: int) -> None:
        super().__init__()
        self.d = shape[-1]
        self.register_buffer("ball", ball.clone())
        exponents = list_exponents(self.d, lowest=lowest, highest=highest)
        self.register_buffer("exponents", exponents, persistent=False)
        self.coefficients = nn.Parameter(torch.zeros(len(exponents), *shape, dtype=torch.float64))


class PolynomialMap(PolynomialSum):
    """``x = g(q) = q + sum_k m_k(s) c_k``, coordinates in which a law is simpler than in the latents.

    An encoder bends the mechanism's coordinates, and with them every term of its law alike. Monomials are of
    degree two at least, so that ``g`` is the identity to first order at ``q = 0``.

    Far outside the data it is a translation, so that it is invertible everywhere if its Jacobian is
    (Hadamard), which `measure_least_stretch` tests.

    Args:
        d: coordinates.
        degree: of the polynomials; 1 leaves ``x = q``.
        ball: where ``s = q`` [whitened units].
    """

    def __init__(self, d: int, *, degree: int, ball: Ball) -> None:
        super().__init__(ball, (d,), lowest=2, highest=degree)

    def evaluate(self, q: Latents) -> tuple[Latents, Float[Tensor, "B d d"]]:
        """``g`` and its Jacobian matrix."""
        value, slope = evaluate_monomials(q, self.exponents, ball=self.ball)
        jacobian = torch.eye(self.d, dtype=q.dtype) + torch.einsum("ki,bkl->bil", self.coefficients, slope)
        return q + value @ self.coefficients, jacobian

    def push(self, q: Latents, v: Latents) -> tuple[Latents, Latents]:
        """State and velocity in the coordinates of the law."""
        x, jacobian = self.evaluate(q)
        return x, (jacobian @ v[:, :, None])[:, :, 0]

    def pull(self, x: Latents, w: Latents) -> tuple[Latents, Latents]:
        """State and velocity as latents; NaN where `invert` does not arrive."""
        q = self.invert(x)
        return q, torch.linalg.solve_ex(self.evaluate(q)[1], w[:, :, None])[0][:, :, 0]

    def measure_bending(self, q: Latents, v: Latents) -> Latents:
        """``d2g/dq2 v v``, the acceleration in these coordinates of a motion without any in the latents."""
        _, _, second = differentiate_monomials(q, self.exponents, ball=self.ball)
        return torch.einsum("bkij,bi,bj->bk", second, v, v) @ self.coefficients

    @torch.no_grad()
    def measure_least_stretch(self) -> float:
        """Smallest singular value of the Jacobian at many states, negative where its determinant is."""
        _, jacobian = self.evaluate(draw_states(self.ball, CHECKED, reach=REACH, seed=0))
        return float(measure_stretch(jacobian)[0].min())

    @torch.no_grad()
    def invert(self, x: Latents, near: Latents | None = None) -> Latents:
        """The latents at ``x``, by bounded Newton steps from ``near``; NaN where they do not arrive."""
        if not len(self.exponents):
            return x.clone()
        q = (x if near is None else near).clone()
        for _ in range(NEWTON_STEPS):
            image, jacobian = self.evaluate(q)
            missed = (x - image).nan_to_num()
            if not float(missed.abs().max()) > ARRIVED:
                break
            step = torch.linalg.solve_ex(jacobian, missed[:, :, None])[0][:, :, 0]
            q = q + step * (
                LONGEST_NEWTON_STEP / step.norm(dim=1, keepdim=True).clamp(min=LONGEST_NEWTON_STEP)
            )
        arrived = (x - self.evaluate(q)[0]).abs().amax(1, keepdim=True) < 1e3 * ARRIVED
        return q.where(arrived, torch.nan)


def measure_stretch(
    jacobian: Float[Tensor, "B d d"],
) -> tuple[Float[Tensor, " B"], Float[Tensor, "B d d"]]:
    """Smallest singular value, negative where the determinant is, and its derivative by the matrix."""
    left, values, right = torch.linalg.svd(jacobian)
    sign = torch.linalg.det(jacobian).sign()
    outer = left[:, :, -1, None] * right[:, None, -1]
    return sign * values[:, -1], sign[:, None, None] * outer


class PolynomialFrame(PolynomialSum):
    """``J(q) = I + sum_k m_k(s) J_k``, the frame in which mass and damping of a law are constant.

    In coordinates that bend, constant matrices of the mechanism become ``J^T M_0 J`` and ``J^T C_0 J`` with
    one ``J``, so that mass and damping share it.

    Args:
        d: coordinates.
        degree: of the polynomials; 0 leaves ``J = I``.
        ball: where ``s = q`` [whitened units].
    """

    def __init__(self, d: int, *, degree: int, ball: Ball) -> None:
        super().__init__(ball, (d, d), lowest=1, highest=degree)

    def evaluate(self, q: Latents) -> tuple[Float[Tensor, "B d d"], Float[Tensor, "B d d d"]]:
        """``J`` and its derivatives by each coordinate, the last axis."""
        value, slope = evaluate_monomials(q, self.exponents, ball=self.ball)
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


def list_law_arrays(
    energy: PolynomialEnergy, mass: PolynomialField, damping: PolynomialField
) -> polynomial_kernels.LawArrays:
    """A law as it is, in its own coordinates, for `lagsplat.stage2.polynomial_kernels`."""
    frame = mass.frame
    # each list of monomials is the beginning of the longest one
    longest = max(energy.exponents, energy.input_exponents, frame.exponents, key=len)
    parents, variables = polynomial_kernels.list_parents(longest.numpy())
    elastic, pushed = (p.detach().numpy() for p in (energy.coefficients, energy.input_coefficients))
    potential, volumes = np.zeros(len(parents)), np.zeros((len(pushed), len(parents)))
    potential[1 : 1 + len(elastic)] = elastic
    volumes[:, 1 : 1 + pushed.shape[1]] = pushed
    return polynomial_kernels.LawArrays(
        parents,
        variables,
        energy.ball[:-1].numpy(),
        float(energy.ball[-1]),
        ROOM,
        potential,
        volumes,
        len(elastic),
        pushed.shape[1],
        1 + len(list_exponents(frame.d, lowest=1, highest=SPRINGS)),
        frame.coefficients.detach().numpy(),
        mass.factor.detach().tril().numpy(),
        damping.factor.detach().tril().numpy(),
        float(mass.floor),
        float(damping.floor),
    )
