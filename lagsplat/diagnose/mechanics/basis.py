"""Basis functions of the coordinates, in which mass, damping, potential and input map are written.

``phi_k(q)`` is a monomial of the scaled coordinates ``x = (q - centre) / scale``, or the cosine or sine of an
integer combination of angles. Functions are sorted by degree, so that a coarser field uses the first few.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import no_type_check

import numpy as np
from jaxtyping import Float64, Int64
from numba import njit

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

    def values(self, q: Float64[np.ndarray, "N d"]) -> Float64[np.ndarray, "N K"]:
        """``phi_k(q_n)``."""
        return _values(self.kind, self.order, self.centre, self.scale, np.ascontiguousarray(q))[0]

    def slopes(self, q: Float64[np.ndarray, "N d"]) -> Float64[np.ndarray, "N K d"]:
        """``d phi_k / d q_i`` at ``q_n``."""
        return _values(self.kind, self.order, self.centre, self.scale, np.ascontiguousarray(q))[1]


def make_polynomial_basis(
    degree: int, *, centre: Float64[np.ndarray, " d"], scale: Float64[np.ndarray, " d"]
) -> Basis:
    """All monomials of the scaled coordinates up to ``degree``, the constant first."""
    d = len(centre)
    orders = sorted(
        (powers for powers in product(range(degree + 1), repeat=d) if sum(powers) <= degree),
        key=lambda powers: (sum(powers), tuple(-i for i in powers)),
    )
    order = np.array(orders, dtype=np.int64).reshape(-1, d)
    return Basis(np.full(len(order), POWER), order, np.asarray(centre, float), np.asarray(scale, float))


def add_angle_functions(basis: Basis, multiples: Int64[np.ndarray, "A d"]) -> Basis:
    """The basis with the cosine and sine of ``multiples @ q`` behind its functions; ``q`` is in radians."""
    kind = np.repeat([COSINE, SINE], len(multiples))
    return replace(
        basis,
        kind=np.concatenate([basis.kind, kind]),
        order=np.concatenate([basis.order, multiples, multiples]),
    )


@njit(cache=True, error_model="numpy")
@no_type_check
def evaluate_basis(kind, order, centre, scale, q, powers, value, slope):
    """Write the functions (K,) and their gradients (K, d) at a single point ``q`` (d,), compiled.

    The first four arguments are those of `Basis`; ``powers`` is scratch (d, 1 + highest power), which
    `evaluate_basis_curvature` reads afterwards.
    """
    n, d = order.shape
    for i in range(d):
        x = (q[i] - centre[i]) / scale[i]
        powers[i, 0] = 1.0
        for e in range(1, powers.shape[1]):
            powers[i, e] = powers[i, e - 1] * x
    for k in range(n):
        if kind[k] == POWER:
            product_of_powers = 1.0
            for i in range(d):
                product_of_powers *= powers[i, order[k, i]]
            value[k] = product_of_powers
            for i in range(d):
                e = order[k, i]
                derivative = 0.0
                if e > 0:
                    derivative = e / scale[i] * powers[i, e - 1]
                    for j in range(d):
                        if j != i:
                            derivative *= powers[j, order[k, j]]
                slope[k, i] = derivative
        else:
            angle = 0.0
            for i in range(d):
                angle += order[k, i] * q[i]
            cosine, sine = np.cos(angle), np.sin(angle)
            value[k] = cosine if kind[k] == COSINE else sine
            by_angle = -sine if kind[k] == COSINE else cosine
            for i in range(d):
                slope[k, i] = by_angle * order[k, i]


@njit(cache=True, error_model="numpy")
@no_type_check
def evaluate_basis_curvature(kind, order, scale, powers, value, curvature):
    """Write the second derivatives (d, d, K) at the last point of `evaluate_basis`, compiled.

    ``powers`` and ``value`` are as `evaluate_basis` left them.
    """
    n, d = order.shape
    for k in range(n):
        for i in range(d):
            for j in range(i + 1):
                if kind[k] != POWER:
                    second = -value[k] * order[k, i] * order[k, j]
                else:
                    e_i = order[k, i]
                    e_j = order[k, j] if i != j else e_i - 1
                    second = e_i * e_j / (scale[i] * scale[j])
                    for m in range(d if second != 0.0 else 0):
                        second *= powers[m, order[k, m] - (1 if m == i else 0) - (1 if m == j else 0)]
                curvature[i, j, k] = second
                curvature[j, i, k] = second


@njit(cache=True)
@no_type_check
def find_highest_power(kind, order):
    """The highest power of a single coordinate in any monomial of a basis, compiled."""
    highest = 0
    for k in range(order.shape[0]):
        if kind[k] == POWER:
            for i in range(order.shape[1]):
                highest = max(highest, order[k, i])
    return highest


@njit(cache=True)
@no_type_check
def _values(kind, order, centre, scale, q):
    n, d, size = q.shape[0], q.shape[1], kind.shape[0]
    value, slope = np.empty((n, size)), np.empty((n, size, d))
    powers = np.empty((d, find_highest_power(kind, order) + 1))
    for m in range(n):
        evaluate_basis(kind, order, centre, scale, q[m], powers, value[m], slope[m])
    return value, slope
