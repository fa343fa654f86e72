"""Functions of the coordinates in which a sim's mass, damping, potential and input map are written.

``phi_k(q)`` is a monomial of the scaled coordinates ``x = (q - centre) / scale``, or the cosine or sine of a
whole multiple of angles. Sorted by degree, so that a coarser field uses the first few.
"""

from dataclasses import dataclass, replace
from itertools import product
from typing import no_type_check

import numpy as np
from jaxtyping import Float64, Int64
from numba import njit

POWER, COSINE, SINE = 0, 1, 2


@dataclass(frozen=True)
class Basis:
    """``kind`` (K,); ``order`` (K, d): powers of a monomial, or multiples of the angles."""

    kind: Int64[np.ndarray, " K"]
    order: Int64[np.ndarray, "K d"]
    centre: Float64[np.ndarray, " d"]
    scale: Float64[np.ndarray, " d"]

    @property
    def size(self) -> int:
        """Number of functions, K."""
        return len(self.kind)

    @property
    def d(self) -> int:
        """Number of coordinates."""
        return len(self.centre)

    def first(self, k: int) -> "Basis":
        """The first ``k`` functions."""
        return replace(self, kind=self.kind[:k], order=self.order[:k])

    def values(self, q: Float64[np.ndarray, "N d"]) -> Float64[np.ndarray, "N K"]:
        """``phi_k(q_n)``."""
        return _values(self.kind, self.order, self.centre, self.scale, np.ascontiguousarray(q))[0]

    def slopes(self, q: Float64[np.ndarray, "N d"]) -> Float64[np.ndarray, "N K d"]:
        """``d phi_k / d q_i`` at ``q_n``."""
        return _values(self.kind, self.order, self.centre, self.scale, np.ascontiguousarray(q))[1]


def make_polynomial_basis(
    degree: int, *, centre: Float64[np.ndarray, " d"], scale: Float64[np.ndarray, " d"]
) -> Basis:
    """All monomials up to ``degree``, the constant first."""
    d = len(centre)
    orders = sorted(
        (e for e in product(range(degree + 1), repeat=d) if sum(e) <= degree),
        key=lambda e: (sum(e), tuple(-i for i in e)),
    )
    order = np.array(orders, dtype=np.int64).reshape(-1, d)
    return Basis(np.full(len(order), POWER), order, np.asarray(centre, float), np.asarray(scale, float))


def add_angle_functions(basis: Basis, multiples: Int64[np.ndarray, "A d"]) -> Basis:
    """The same and the cosine and sine of each of ``multiples`` of the coordinates [rad]."""
    kind = np.repeat([COSINE, SINE], len(multiples))
    return replace(
        basis,
        kind=np.concatenate([basis.kind, kind]),
        order=np.concatenate([basis.order, multiples, multiples]),
    )


@njit(cache=True, error_model="numpy")
@no_type_check
def evaluate_basis(kind, order, centre, scale, q, powers, value, slope):
    """Write ``phi`` (K,) and its gradient (K, d) at ``q`` (d,); ``powers`` (d, 1 + highest) is scratch."""
    n, d = order.shape
    for i in range(d):
        x = (q[i] - centre[i]) / scale[i]
        powers[i, 0] = 1.0
        for e in range(1, powers.shape[1]):
            powers[i, e] = powers[i, e - 1] * x
    for k in range(n):
        if kind[k] == POWER:
            whole = 1.0
            for i in range(d):
                whole *= powers[i, order[k, i]]
            value[k] = whole
            for i in range(d):
                e = order[k, i]
                part = 0.0
                if e > 0:
                    part = e / scale[i] * powers[i, e - 1]
                    for j in range(d):
                        if j != i:
                            part *= powers[j, order[k, j]]
                slope[k, i] = part
        else:
            angle = 0.0
            for i in range(d):
                angle += order[k, i] * q[i]
            cosine, sine = np.cos(angle), np.sin(angle)
            value[k] = cosine if kind[k] == COSINE else sine
            turn = -sine if kind[k] == COSINE else cosine
            for i in range(d):
                slope[k, i] = turn * order[k, i]


@njit(cache=True, error_model="numpy")
@no_type_check
def evaluate_basis_curvature(kind, order, scale, powers, value, curvature):
    """Write the second derivatives (d, d, K) after `evaluate_basis` has written ``powers`` and ``value``."""
    n, d = order.shape
    for k in range(n):
        for i in range(d):
            for j in range(i + 1):
                if kind[k] != POWER:
                    part = -value[k] * order[k, i] * order[k, j]
                else:
                    own = order[k, i]
                    other = order[k, j] if i != j else own - 1
                    part = own * other / (scale[i] * scale[j])
                    for m in range(d if part != 0.0 else 0):
                        part *= powers[m, order[k, m] - (1 if m == i else 0) - (1 if m == j else 0)]
                curvature[i, j, k] = part
                curvature[j, i, k] = part


@njit(cache=True)
@no_type_check
def find_highest_power(kind, order):
    """The highest power of one coordinate in any monomial."""
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
