"""Polynomial terms of the Lagrangian: potential and input potentials, and matrix fields, of low degree.

Terms of high degree are polynomials of the soft-clipped state ``s``. Inside a ball around the data ``s`` is
``q``; outside it is bounded, and so are the terms and their slopes. Springs and constant forces are never
clipped: outside the data a law is a linear one, more or less. A clip that began inside the data would bend a
line: with ``s = 4 tanh(q / 4)`` a quartic of a linear spring is 1 to 2 % too stiff at rest. A box would leave
polynomials free in its corners, twice as far from its center as any state in four coordinates.
"""

from collections.abc import Sequence
from itertools import combinations_with_replacement

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from lagsplat.array_types import Inputs, Latents, Spd
from lagsplat.stage2 import polynomial_kernels
from lagsplat.stage2.networks import cholesky_solve, factor_positive

NEWTON_STEPS, LONGEST_NEWTON_STEP, ARRIVED = 40, 0.5, 1e-12  # [-, whitened units, whitened units]
# The numbers below were set by hand, with both simulated arms and the toy in view.
ROOM = 0.25  # of the radius of the ball, by which the clipped state leaves it at most
OUTSIDE = 1e-3  # share of the states outside the ball: outliers of the encoder
SPRINGS, LOADS = 2, 1  # degrees up to which V and nu are polynomials of the state itself
CHECKED, REACH = 8192, 2.0  # points at which a map must be invertible, and how many radii off they are

Ball = Float[Tensor, " d1"]
"""Center of the ball in which the clipped state is the state, and its radius, which is last."""

Monomials = tuple[Float[Tensor, "B k"], Float[Tensor, "B k d"]]
"""Values and gradients of monomials at ``B`` states."""


def enclose_states(q: Latents) -> Ball:
    """The ball around the mean of some states that leaves out one in a thousand."""
    center = q.mean(0)
    return torch.cat([center, (q - center).norm(dim=1).quantile(1.0 - OUTSIDE)[None]])


def make_wide_ball(d: int, radius: float = 1e99) -> Ball:
    """A ball around zero, by default so wide that nothing is clipped."""
    return torch.cat([torch.zeros(d, dtype=torch.float64), torch.tensor([radius], dtype=torch.float64)])


def draw_states(ball: Ball, n: int, *, reach: float, seed: int) -> Latents:
    """Draw states at random, in all directions and uniformly up to ``reach`` times the radius of a ball."""
    generator = torch.Generator().manual_seed(seed)
    side = torch.randn(n, len(ball) - 1, generator=generator, dtype=torch.float64)
    r = reach * ball[-1] * torch.rand(n, 1, generator=generator, dtype=torch.float64)
    return ball[:-1] + r * side / side.norm(dim=1, keepdim=True)


def list_exponents(d: int, *, lowest: int, highest: int) -> Float[Tensor, "k d"]:
    """Exponents of all monomials of ``d`` variables of the degrees ``lowest`` to ``highest``, by degree."""
    rows = [
        [chosen.count(i) for i in range(d)]
        for degree in range(lowest, highest + 1)
        for chosen in combinations_with_replacement(range(d), degree)
    ]
    return torch.tensor(rows, dtype=torch.float64).reshape(-1, d)


class SoftClip:
    """The state ``s = c + a(r) (q - c)``, ``r = |q - c|``, that is ``q`` in a ball and bounded outside.

    Outside, ``r a(r) = R (1 + ROOM tanh((r - R) / (ROOM R)))``; two derivatives are continuous.

    Args:
        q: states [whitened units].
        ball: its center ``c`` and radius ``R``.
    """

    def __init__(self, q: Latents, ball: Ball) -> None:
        center, radius = ball[:-1], ball[-1]
        self.z = q - center
        norm = self.z.norm(dim=1, keepdim=True)
        self.all_inside = not bool((norm > radius).any())
        r = norm.clamp(min=radius)  # whereby all below is the identity's inside
        tanh = torch.tanh((r - radius) / (ROOM * radius))
        self.slope = 1.0 - tanh * tanh  # of r a(r)
        self.bend = -2.0 / (ROOM * radius) * tanh * self.slope
        self.share = radius * (1.0 + ROOM * tanh) / r  # a
        first = (self.slope - self.share) / r  # da/dr, and the second derivative
        second = (self.bend - 2.0 * first) / r
        self.r, self.first = r, first
        self.turned = first / r
        self.curved = (second - self.turned) / r**2
        self.s = q if self.all_inside else center + self.share * self.z

    def pull_back(self, slopes: Float[Tensor, "B k d"]) -> Float[Tensor, "B k d"]:
        """Slopes by ``q`` of functions whose ``slopes`` by ``s`` are known."""
        if self.all_inside:
            return slopes
        along = slopes @ self.z[:, :, None]
        return self.share[:, None] * slopes + self.turned[:, None] * along * self.z[:, None]

    def pull_back_bends(
        self, slopes: Float[Tensor, "B k d"], bends: Float[Tensor, "B k d d"]
    ) -> Float[Tensor, "B k d d"]:
        """Second derivatives by ``q`` of functions whose derivatives by ``s`` are known."""
        if self.all_inside:
            return bends
        z, d = self.z, self.z.shape[1]
        eye = torch.eye(d, dtype=z.dtype)
        jacobian = self.share[:, :, None] * eye + self.turned[:, :, None] * z[:, :, None] * z[:, None]
        along = (slopes @ z[:, :, None])[..., None]
        spread = slopes[..., None] * z[:, None, None]
        turned, curved = (part[:, :, None, None] for part in (self.turned, self.curved))
        own = turned * (spread + spread.mT + along * eye)
        own = own + curved * along * (z[:, :, None] * z[:, None])[:, None]
        return jacobian[:, None] @ bends @ jacobian[:, None] + own


def evaluate_monomials(
    q: Latents, exponents: Float[Tensor, "k d"], *, ball: Ball, free_degree: int = 0
) -> Monomials:
    """Values and gradients at ``q`` of monomials of the state ``s`` that is clipped softly (`SoftClip`).

    Args:
        q: states [whitened units].
        exponents: powers of each coordinate, one row a monomial, from `list_exponents`.
        ball: where ``s = q`` [whitened units].
        free_degree: up to which monomials are of the state itself.

    Example:
        >>> import torch
        >>> from lagsplat.stage2.polynomials import evaluate_monomials, list_exponents
        >>> exponents = list_exponents(1, lowest=1, highest=2)
        >>> ball = torch.tensor([0.0, 9.0]).double()
        >>> value, slope = evaluate_monomials(torch.tensor([[0.1]]).double(), exponents, ball=ball)
        >>> [round(float(x), 4) for x in (*value[0], *slope[0, :, 0])]
        [0.1, 0.01, 1.0, 0.2]
    """
    clip = SoftClip(q, ball)
    if not clip.all_inside and (free := exponents.sum(1) <= free_degree).any():
        near = evaluate_monomials(q, exponents[free], ball=make_wide_ball(q.shape[1]))
        beyond = evaluate_monomials(q, exponents[~free], ball=ball)
        return torch.cat([near[0], beyond[0]], 1), torch.cat([near[1], beyond[1]], 1)
    levels, order, d = _raise_powers(clip.s, exponents), exponents.long(), q.shape[1]
    factors = [levels[order[:, i], i] for i in range(d)]
    value = torch.ones((len(exponents), len(q)), dtype=q.dtype)
    for factor in factors:
        value = value * factor
    slopes = []
    for i in range(d):
        slope = exponents[:, i, None] * levels[(order[:, i] - 1).clamp(min=0), i]
        for j in range(d):
            if j != i:
                slope = slope * factors[j]
        slopes.append(slope)
    return value.T, clip.pull_back(torch.stack(slopes, 2).permute(1, 0, 2))


def differentiate_monomials(
    q: Latents, exponents: Float[Tensor, "k d"], *, ball: Ball, free_degree: int = 0
) -> tuple[Float[Tensor, "B k"], Float[Tensor, "B k d"], Float[Tensor, "B k d d"]]:
    """Values, gradients and second derivatives of `evaluate_monomials`."""
    clip = SoftClip(q, ball)
    if not clip.all_inside and (free := exponents.sum(1) <= free_degree).any():
        near = differentiate_monomials(q, exponents[free], ball=make_wide_ball(q.shape[1]))
        beyond = differentiate_monomials(q, exponents[~free], ball=ball)
        value, slope, bends = (torch.cat(pair, 1) for pair in zip(near, beyond, strict=True))
        return value, slope, bends
    levels, order, d = _raise_powers(clip.s, exponents), exponents.long(), q.shape[1]
    rows = []  # value, first and second derivative of the power of each coordinate
    for i in range(d):
        power = exponents[:, i, None]
        lower, lowest = (levels[(order[:, i] - n).clamp(min=0), i] for n in (1, 2))
        rows.append((levels[order[:, i], i], power * lower, power * (power - 1.0) * lowest))
    one = torch.ones((len(exponents), len(q)), dtype=q.dtype)

    def multiply(orders: Sequence[int]) -> Float[Tensor, "k B"]:
        product = one
        for row, derivative in zip(rows, orders, strict=True):
            product = product * row[derivative]
        return product

    at = range(d)
    value = multiply([0] * d)
    slope = torch.stack([multiply([int(i == m) for m in at]) for i in at], 2).permute(1, 0, 2)
    bend = [multiply([int(i == m) + int(j == m) for m in at]) for i in at for j in at]
    bends = torch.stack(bend, 2).reshape(len(exponents), len(q), d, d).permute(1, 0, 2, 3)
    return value.T, clip.pull_back(slope), clip.pull_back_bends(slope, bends)


def _raise_powers(s: Latents, exponents: Float[Tensor, "k d"]) -> Float[Tensor, "n d B"]:
    """Powers of the clipped state, from the zeroth on."""
    powers = [torch.ones_like(s.T)]
    for _ in range(int(exponents.max()) if exponents.numel() else 0):
        powers.append(powers[-1] * s.T)
    return torch.stack(powers)


class PolynomialEnergy(nn.Module):
    """``U(q, u) = V - u.nu`` with polynomials ``V`` and ``nu`` in their coefficients.

    Quadratic ``V`` and linear ``nu`` are polynomials of the state, and what is of a higher degree of the
    clipped state. So far outside the data a spring prevails, and where that is stable
    (`measure_far_stiffness`) every motion is bounded under any input.
    `lagsplat.stage2.lagrangian.find_equilibria` counts the equilibria inside.

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
