"""Cholesky's method, compiled: for one small system, and for many side by side.

Source: Golub and Van Loan, Matrix Computations, 4th ed., 4.2.
"""

import math
from typing import no_type_check

from numba import njit

MIN_PIVOT = 1e-12  # floor of a squared pivot, so that a mass matrix that is not positive gives no NaN


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
@no_type_check
def factorize_batch(a):
    """Overwrite the lower triangle of ``a`` (d, d, R) with its Cholesky factor, the diagonal inverted."""
    d, n = a.shape[0], a.shape[2]
    for j in range(d):
        for k in range(j):
            for i in range(j, d):
                for r in range(n):
                    a[i, j, r] -= a[i, k, r] * a[j, k, r]
        for r in range(n):
            a[j, j, r] = 1.0 / math.sqrt(max(a[j, j, r], MIN_PIVOT))
        for i in range(j + 1, d):
            for r in range(n):
                a[i, j, r] *= a[j, j, r]


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
@no_type_check
def solve_batch(a, b):
    """Replace the second half of ``b`` (2 d, R) by the solution for the factor ``a`` (d, d, R)."""
    d, n = a.shape[0], a.shape[2]
    for i in range(d):
        for k in range(i):
            for r in range(n):
                b[d + i, r] -= a[i, k, r] * b[d + k, r]
        for r in range(n):
            b[d + i, r] *= a[i, i, r]
    for i in range(d - 1, -1, -1):
        for k in range(i + 1, d):
            for r in range(n):
                b[d + i, r] -= a[k, i, r] * b[d + k, r]
        for r in range(n):
            b[d + i, r] *= a[i, i, r]
