"""Basis functions of the coordinates, in which mass, damping, potential and input map are written.

``phi_k(q)`` is a monomial of the scaled coordinates ``x = (q - centre) / scale``, or the cosine or sine of an
integer combination of angles. Functions are sorted by degree, so that a coarser field uses the first few.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import no_type_check

import numpy as np
from jaxtyping import Float64, Int64
from numba import njit

from lagsplat.integer_lists import list_powers

POWER, COSINE, SINE = 0, 1, 2  # the kinds of basis functions, as the compiled code takes them


@dataclass(frozen=True)
class Basis:
    """``K`` functions of ``d`` coordinates, the constant first."""

    kind: Int64[np.ndarray, " K"]  # `POWER`, `COSINE` or `SINE`
    order: Int64[np.ndarray, "K d"]  # powers of a monomial, or integer multiples of the angles
    centre: Float64[np.ndarray, " d"]  # middle of the region [unit of the coordinate]
    scale: Float64[np.ndarray, " d"]  # half the width of the region [unit of the coordinate]

    @property
    def size(self) -> int:
        """Number of functions, K."""
        return len(self.kind)

    def first(self, k: int) -> "Basis":
        """The basis of the first ``k`` functions."""
        return replace(self, kind=self.kind[:k], order=self.order[:k])

    @cached_property
    def derivatives(self) -> tuple[Int64[np.ndarray, "d K"], Float64[np.ndarray, "d K"]]:
        """The derivative of each function by each coordinate: another function of the basis, and a factor.

        Raises:
            ValueError: a derivative is not in the basis.
        """
        functions = list(zip(self.kind.tolist(), self.order.tolist(), strict=True))
        number = {(kind, *order): k for k, (kind, order) in enumerate(functions)}
        target, factor = np.zeros(self.order.T.shape, np.int64), np.zeros(self.order.T.shape)
        for k, (kind, order) in enumerate(functions):
            for i in np.flatnonzero(order):
                lower = [e - (j == i) for j, e in enumerate(order)] if kind == POWER else order
                name = ({POWER: POWER, COSINE: SINE, SINE: COSINE}[kind], *lower)
                if name not in number:
                    raise ValueError(
                        f"function {k} of the basis has a derivative that is none of its functions"
                    )
                target[i, k] = number[name]
                factor[i, k] = order[i] / self.scale[i] if kind == POWER else order[i] * (2 * kind - 3)
        return target, factor

    @property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """Kind, order, centre, scale and both arrays of `derivatives`, as compiled code takes a basis."""
        return self.kind, self.order, self.centre, self.scale, *self.derivatives

    def values(self, q: Float64[np.ndarray, "N d"]) -> Float64[np.ndarray, "N K"]:
        """``phi_k(q_n)``."""
        points, phi = np.ascontiguousarray(q.T), np.empty((self.size, len(q)))
        evaluate_basis(self.arrays, points, np.empty(points.shape), np.empty((2, *points.shape)), phi)
        return np.ascontiguousarray(phi.T)

    def slopes(self, q: Float64[np.ndarray, "N d"]) -> Float64[np.ndarray, "N K d"]:
        """``d phi_k / d q_i`` at ``q_n``."""
        target, factor = self.derivatives
        return np.ascontiguousarray((self.values(q)[:, target] * factor).transpose(0, 2, 1))


def make_polynomial_basis(
    degree: int, *, centre: Float64[np.ndarray, " d"], scale: Float64[np.ndarray, " d"]
) -> Basis:
    """All monomials of the scaled coordinates up to ``degree``, the constant first."""
    order = list_powers(len(centre), lowest=0, highest=degree)
    return Basis(np.full(len(order), POWER), order, np.asarray(centre, float), np.asarray(scale, float))


def add_angle_functions(basis: Basis, multiples: Int64[np.ndarray, "A d"]) -> Basis:
    """The basis with the cosine and sine of ``multiples @ q`` behind its functions; ``q`` is in radians."""
    kind = np.repeat([COSINE, SINE], len(multiples))
    return replace(
        basis,
        kind=np.concatenate([basis.kind, kind]),
        order=np.concatenate([basis.order, multiples, multiples]),
    )


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
@no_type_check
def _evaluate_wave(order, k, waves, phi, real, imaginary):
    """Write cosine and sine of the sum of ``order[k]`` times the angles into these rows of ``phi``."""
    n = phi.shape[1]
    for r in range(n):
        phi[real, r], phi[imaginary, r] = 1.0, 0.0
    for i in range(order.shape[1]):
        sign = 1.0 if order[k, i] > 0 else -1.0
        for _ in range(abs(order[k, i])):
            for r in range(n):
                before, c, s = phi[real, r], waves[0, i, r], sign * waves[1, i, r]
                phi[real, r] = before * c - phi[imaginary, r] * s
                phi[imaginary, r] = phi[imaginary, r] * c + before * s


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
@no_type_check
def evaluate_basis(basis, q, x, waves, phi):
    """Write the functions (K, R) at the points ``q`` (d, R), with ``x`` (d, R) and ``waves`` (2, d, R).

    Both are scratch; ``basis`` is `Basis.arrays`. A monomial is a coordinate times its derivative, which
    comes before it.
    """
    kind, order, centre, scale, target, _ = basis
    (k_all, d), n = order.shape, q.shape[1]
    for i in range(d):
        middle, factor = centre[i], 1.0 / scale[i]
        for r in range(n):
            x[i, r] = (q[i, r] - middle) * factor
        for r in range(n if kind[k_all - 1] != POWER else 0):
            waves[0, i, r], waves[1, i, r] = math.cos(q[i, r]), math.sin(q[i, r])
    for k in range(k_all):
        i = 0
        while i < d - 1 and order[k, i] == 0:
            i += 1
        lower = target[i, k]
        if order[k, i] == 0:
            for r in range(n):
                phi[k, r] = 1.0
        elif kind[k] == POWER:
            for r in range(n):
                phi[k, r] = phi[lower, r] * x[i, r]
        elif kind[k] == COSINE:
            _evaluate_wave(order, k, waves, phi, k, lower)
