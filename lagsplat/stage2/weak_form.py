"""Start of a polynomial law: least squares on the weak form of its equation of motion.

``M a + C v + grad V(q) - u.grad nu(q) = 0`` is multiplied by a bump ``phi`` and integrated by parts: ``a``
becomes ``q phi''`` and ``v`` becomes ``-q phi'``, so that no noisy series is differentiated. It is linear in
constant ``M`` and ``C`` and in the coefficients of the polynomials. Errors are measured as displacements:
forces are divided by the mean loaded stiffness, which depends on the coefficients, so that the least squares
are nonlinear. Divided by anything fixed, a direction of little motion would lose its stiffness, its mass and
its inputs together, for then its balance holds without error. A motion that only follows its inputs still
gives the law's static part, and noise counts little in stiff directions. ``M`` and ``C`` are positive
definite by their factors.

Source: Messenger and Bortz 2021, DOI 10.1137/20M1343166 (weak form, bumps).
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float64
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize

from lagsplat.array_types import Series
from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.monomials import enclose_states, evaluate_monomials, list_exponents, make_wide_ball
from lagsplat.stage2.config import FormConfig
from lagsplat.stage2.lagrangian import Coefficients, Floors, Lagrangian

BUMP_ORDER = 4  # of phi = (1 - x^2)^4, whose first three derivatives vanish at its ends
# The numbers below were set by hand, with both simulated arms in view.
MOST_BUMPS = 1000
MOST_STEPS, CONVERGED = 60, 1e-6
RIDGE = 1e-6  # on coefficients, with columns of unit size
STIFFNESS_STATES = 200  # at which the loaded stiffness is measured
LEAST_STIFFNESS = 0.02  # its smallest eigenvalue at these states, of which the mean of all is about 1
CONVEXITY = 10.0  # weight of a stiffness below that
FIRST_FACTOR = 0.1  # of M and C, where the stiffness is 1
MASS_FLOOR, DAMPING_FLOOR = 3e-3, 1e-4  # of the mean eigenvalue at the start

Matrix = Float64[np.ndarray, "d d"]
Columns = Float64[np.ndarray, "T k d"]
Curvatures = Float64[np.ndarray, "s k d d"]


def fit_weak_form(
    trajectory: EncodedTrajectory, form: FormConfig, *, half_width: int, time_unit_s: float, seed: int
) -> Lagrangian:
    """Fit a polynomial law to a trajectory as encoded, not smoothed.

    Args:
        trajectory: states and inputs as measured; a smoothed input would look like inertia.
        form: degrees of the polynomials; mass and damping are constant in this fit.
        half_width: of a bump [frames]: a third to two thirds of a period average the most noise.
        time_unit_s: internal unit of time of the law [s].
        seed: of the law, which has no random weights where it is polynomial.

    Raises:
        ValueError: no segment is as long as a bump.
    """
    d, n_inputs = trajectory.latents.shape[1], trajectory.inputs.shape[1]
    exponents = list_exponents(d, lowest=1, highest=form.degrees.potential)
    input_exponents = list_exponents(d, lowest=1, highest=form.degrees.inputs)
    static, inertia, viscous, q, u = _integrate(
        trajectory, exponents, input_exponents, half_width=half_width, time_unit_s=time_unit_s
    )
    squares = [exponents.tolist().index([2.0 * (i == j) for i in range(d)]) for j in range(d)]
    # the coefficients of the squares sum to d
    target = -d * static[:, squares[0]]
    static[:, squares[1:]] -= static[:, squares[:1]]
    static = np.delete(static, squares[0], axis=1)
    curvatures = _list_curvatures(q, u, exponents, input_exponents)
    offset = d * curvatures[:, squares[0]]
    curvatures[:, squares[1:]] -= curvatures[:, squares[:1]]
    columns = np.concatenate([static, inertia, viscous, -target[:, None]], axis=1)
    flat = columns.reshape(len(columns), -1)
    products = (flat.T @ flat / len(flat)).reshape(*columns.shape[1:], *columns.shape[1:])
    balance = _Balance(
        products.transpose(1, 3, 0, 2).copy(),
        np.delete(curvatures, squares[0], axis=1),
        offset,
        # a mode above half the frame rate shows in no film
        (trajectory.dt_s / (np.pi * time_unit_s)) ** 2,
    )
    x, mass, damping = balance.minimize_displacements()
    elastic, pushed = np.split(x, [len(exponents) - 1])
    elastic = np.insert(elastic, squares[0], d - elastic[[k - 1 for k in squares[1:]]].sum())
    pushed = pushed.reshape(n_inputs, len(input_exponents))
    # slower than half the frame rate, or the law has modes that no film shows and no rollout follows
    least_mass = max(MASS_FLOOR * np.trace(mass) / d, balance.least_mass)
    floors = Floors(least_mass, DAMPING_FLOOR * np.trace(damping) / d, 0.0)
    two = 2.0 * torch.eye(d, dtype=torch.float64)
    none = torch.zeros(n_inputs, d, dtype=torch.float64)
    start = Coefficients(torch.from_numpy(mass), torch.from_numpy(damping), two, none, 0.0 * two[0])
    ball = enclose_states(torch.from_numpy(trajectory.latents))
    lagrangian = Lagrangian(start, form=form, floors=floors, time_unit_s=time_unit_s, seed=seed, ball=ball)
    assert lagrangian.energy is not None
    with torch.no_grad():
        lagrangian.energy.coefficients.copy_(torch.from_numpy(elastic))
        lagrangian.energy.input_coefficients.copy_(torch.from_numpy(pushed))
    return lagrangian


class WeakForm(NamedTuple):
    """Columns of the equation for every bump, and some states and inputs at the bumps' middles."""

    static: Columns  # of V, then of nu, input by input
    inertia: Columns  # of the lower triangle of M
    viscous: Columns  # of the lower triangle of C
    q: Series
    u: Series


def _integrate(
    trajectory: EncodedTrajectory,
    exponents: torch.Tensor,
    input_exponents: torch.Tensor,
    *,
    half_width: int,
    time_unit_s: float,
) -> WeakForm:
    """Integrate every column over bumps that are spread evenly."""
    dt_s, taps = trajectory.dt_s, np.arange(-half_width, half_width + 1)
    phi, first, second = _make_bump(half_width, dt_s / time_unit_s)
    room = sum(max(0, b - a - 2 * half_width) for a, b in trajectory.segments)
    if room < 1:
        longest = max((stop - start for start, stop in trajectory.segments), default=0)
        raise ValueError(
            f"the longest training segment has {longest} frames, and a bump of the weak form needs "
            f"{2 * half_width + 1}: record longer clips"
        )
    every = max(1, room // MOST_BUMPS)
    parts = []
    for start, stop in trajectory.segments:
        q, u = _resample(trajectory, start, stop)
        middles = np.arange(half_width, len(q) - half_width, every)
        if not len(middles):
            continue
        at = middles[:, None] + taps
        elastic, pushed = _gradients(q, exponents), _gradients(q, input_exponents)
        static = np.zeros((len(middles), len(exponents) + u.shape[1] * len(input_exponents), q.shape[1]))
        for column, share in zip(at.T, phi, strict=True):
            each = -u[column][:, :, None, None] * pushed[column][:, None]
            static[:, : len(exponents)] += share * elastic[column]
            static[:, len(exponents) :] += share * each.reshape(len(column), -1, q.shape[1])
        inertia = np.einsum("tnd,n->td", q[at], second)
        viscous = -np.einsum("tnd,n->td", q[at], first)
        parts.append(WeakForm(static, _symmetric(inertia), _symmetric(viscous), q[middles], u[middles]))
    return WeakForm(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def _make_bump(half_width: int, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """``phi`` of unit sum with its first and second derivatives, at frames ``step`` apart."""
    p, x, width = BUMP_ORDER, np.arange(-half_width, half_width + 1) / half_width, half_width * step
    base = 1.0 - x**2
    phi = base**p
    first = -2.0 * p * x * base ** (p - 1) / width
    second = (4.0 * p * (p - 1) * x**2 * base ** (p - 2) - 2.0 * p * base ** (p - 1)) / width**2
    return phi / phi.sum(), first / phi.sum(), second / phi.sum()


def _resample(trajectory: EncodedTrajectory, start: int, stop: int) -> tuple[Series, Series]:
    """Latents and inputs of a segment, ``dt_s`` apart."""
    q, u, clock = trajectory.latents[start:stop], trajectory.inputs[start:stop], trajectory.clock
    if clock.time_s is None or len(q) < 2:
        return q, u
    time_s = clock.time_s[start:stop]
    even_s = np.arange(time_s[0], time_s[-1], clock.dt_s)
    even_u = CubicSpline(time_s, u)(even_s) if u.size else np.zeros((len(even_s), 0))
    return CubicSpline(time_s, q)(even_s), even_u


def _gradients(q: Series, exponents: torch.Tensor) -> Columns:
    return evaluate_monomials(torch.from_numpy(q), exponents, ball=make_wide_ball(q.shape[1]))[1].numpy()


def _symmetric(x: Series) -> Columns:
    """Columns of ``S x`` for the lower triangle of a symmetric ``S``, row by row."""
    d = x.shape[1]
    columns = []
    for i in range(d):
        for j in range(i + 1):
            column = np.zeros_like(x)
            column[:, i] = x[:, j]
            column[:, j] = x[:, i]
            columns.append(column)
    return np.stack(columns, axis=1)


def _list_curvatures(
    q: Series, u: Series, exponents: torch.Tensor, input_exponents: torch.Tensor
) -> Curvatures:
    """Hessian of ``V - u.nu`` at some states by each coefficient, by central differences."""
    some = np.unique(np.linspace(0, len(q) - 1, STIFFNESS_STATES).astype(int))
    q, u, d = q[some], u[some], q.shape[1]

    def slopes(x: Series) -> Columns:
        pushed = -u[:, :, None, None] * _gradients(x, input_exponents)[:, None]
        return np.concatenate([_gradients(x, exponents), pushed.reshape(len(x), -1, d)], axis=1)

    return np.stack([(slopes(q + step) - slopes(q - step)) / 2e-4 for step in 1e-4 * np.eye(d)], axis=3)


@dataclass(frozen=True)
class _Balance:
    """Balance of forces of all bumps; unknown are static coefficients, then M and C, then one that is 1.

    Forces are linear in these, so that products of columns, summed over the bumps, are all that is needed of
    them. The loaded stiffness at some states is ``offset + curvatures.static``; ``least_mass`` is the
    smallest eigenvalue of the mass.
    """

    products: Float64[np.ndarray, "d d p1 p1"]  # means over the bumps
    curvatures: Curvatures
    offset: Float64[np.ndarray, "s d d"]
    least_mass: float

    def minimize_displacements(self) -> tuple[np.ndarray, Matrix, Matrix]:
        """Static coefficients, mass and damping that leave the smallest errors as displacements."""
        d, k = self.offset.shape[1], self.curvatures.shape[1]
        eye = np.eye(d)
        mean, offset = self.curvatures.mean(0), self.offset.mean(0)
        level = np.linalg.lstsq(mean.reshape(k, -1).T, (eye - offset).ravel(), rcond=None)[0]
        factors = np.tile(FIRST_FACTOR * eye[np.tril_indices(d)], 2)
        scale = np.concatenate([1.0 / self._sizes, np.ones(len(factors))])

        z = np.concatenate([level, factors]) / scale
        for convexity in (0.0, CONVEXITY):
            z = self._minimize(z, scale, convexity)
        theta = scale * z
        mass, damping = self._multiply(self._unpack(theta))
        return theta[:k], mass, damping

    def _minimize(self, start: np.ndarray, scale: np.ndarray, convexity: float) -> np.ndarray:
        @lru_cache(maxsize=1)
        def differentiate(z: bytes) -> tuple[np.ndarray, np.ndarray]:
            gradient, curvature = self._differentiate(scale * np.frombuffer(z), convexity)
            return scale * gradient, scale[:, None] * curvature * scale

        solved = minimize(
            lambda z: self._measure_misfit(scale * z, convexity),
            start,
            jac=lambda z: differentiate(z.tobytes())[0],
            hess=lambda z: differentiate(z.tobytes())[1],  # of Gauss and Newton
            method="trust-exact",
            options={"maxiter": MOST_STEPS, "gtol": CONVERGED},
        )
        return solved.x

    def _unpack(self, theta: np.ndarray) -> Float64[np.ndarray, "2 d d"]:
        d = self.offset.shape[1]
        lower = np.zeros((2, d, d))
        lower[:, *np.tril_indices(d)] = theta[self.curvatures.shape[1] :].reshape(2, -1)
        return lower

    def _multiply(self, lower: Float64[np.ndarray, "2 d d"]) -> Float64[np.ndarray, "2 d d"]:
        least = np.array([self.least_mass, 0.0])[:, None, None] * np.eye(lower.shape[1])
        return lower @ lower.swapaxes(1, 2) + least

    def _open(self, theta: np.ndarray) -> tuple[np.ndarray, Matrix, Float64[np.ndarray, "s d d"]]:
        """All coefficients, the compliance that weighs forces, and the loaded stiffness at some states."""
        x, inner = theta[: self.curvatures.shape[1]], np.tril_indices(self.offset.shape[1])
        y = np.concatenate([x, *(m[inner] for m in self._multiply(self._unpack(theta))), [1.0]])
        stiffness = self.offset + np.einsum("k,skij->sij", x, self.curvatures)
        return y, np.linalg.inv(stiffness.mean(0)), stiffness

    def _measure_misfit(self, theta: np.ndarray, convexity: float) -> float:
        """Half the mean square displacement, with prior and penalty of soft springs."""
        y, weight, stiffness = self._open(theta)
        forces = self.products @ y @ y
        prior = RIDGE * np.square(theta[: self.curvatures.shape[1]] * self._sizes).sum()
        short = np.maximum(LEAST_STIFFNESS - np.linalg.eigvalsh(stiffness)[:, 0], 0.0)
        penalty = convexity**2 * np.square(short).mean()
        return 0.5 * float(np.sum((weight.T @ weight) * forces) + prior + penalty)

    def _differentiate(self, theta: np.ndarray, convexity: float) -> tuple[np.ndarray, np.ndarray]:
        """Gradient of the misfit, and its second derivative after Gauss and Newton."""
        y, weight, stiffness = self._open(theta)
        k = self.curvatures.shape[1]
        square = weight.T @ weight
        along = (self.products @ y)[..., :-1]
        forces = self.products @ y @ y
        # the weight, too, depends on the static coefficients
        bent = weight @ self.curvatures.mean(0) @ weight
        by_y = np.einsum("ab,abm->m", square, along)
        by_y[:k] -= np.einsum("kab,ab->k", bent, weight @ forces)
        by_yy = np.tensordot(square, self._products_of_unknowns, 2)
        mixed = np.einsum("kab,abm->mk", weight.T @ bent, along)
        by_yy[:, :k] -= mixed
        by_yy[:k] -= mixed.T
        by_yy[:k, :k] += np.einsum("kab,lab->kl", bent @ forces, bent)
        chain = self._differentiate_coefficients(theta)
        gradient, curvature = chain @ by_y, chain @ by_yy @ chain.T
        ridge = RIDGE * self._sizes**2
        gradient[:k] += ridge * theta[:k]
        curvature[np.arange(k), np.arange(k)] += ridge
        values, vectors = np.linalg.eigh(stiffness)
        short = convexity * np.maximum(LEAST_STIFFNESS - values[:, 0], 0.0)
        weakest = vectors[:, :, 0] * (short > 0.0)[:, None]
        softer = -convexity * np.einsum("si,skij,sj->sk", weakest, self.curvatures, weakest)
        gradient[:k] += softer.T @ short / len(short)
        curvature[:k, :k] += softer.T @ softer / len(short)
        return gradient, curvature

    def _differentiate_coefficients(self, theta: np.ndarray) -> Float64[np.ndarray, "q p"]:
        """Derivatives of all coefficients by static ones and by the elements of both factors."""
        k, d = self.curvatures.shape[1], self.offset.shape[1]
        rows, cols = np.tril_indices(d)
        n, chain = len(rows), np.eye(len(theta))
        units = np.zeros((n, d, d))
        units[np.arange(n), rows, cols] = 1.0
        for start, lower in zip((k, k + n), self._unpack(theta), strict=True):
            # the lower triangle of L L^T by each element of L
            moved = units @ lower.T + lower @ units.swapaxes(1, 2)
            chain[start : start + n, start : start + n] = moved[:, rows, cols]
        return chain

    @cached_property
    def _products_of_unknowns(self) -> Float64[np.ndarray, "d d p p"]:
        return self.products[..., :-1, :-1].copy()

    @cached_property
    def _sizes(self) -> np.ndarray:
        squares = np.diagonal(np.trace(self.products) / self.offset.shape[1])
        return np.sqrt(squares[: self.curvatures.shape[1]])
