"""Lists of whole numbers: powers of monomials, and numbers that are spread evenly."""

from itertools import combinations_with_replacement

import numpy as np
from jaxtyping import Int64


def list_powers(d: int, *, lowest: int, highest: int) -> Int64[np.ndarray, "k d"]:
    """Powers of all monomials of ``d`` variables of the degrees ``lowest`` to ``highest``, by degree."""
    rows = [
        [chosen.count(i) for i in range(d)]
        for degree in range(lowest, highest + 1)
        for chosen in combinations_with_replacement(range(d), degree)
    ]
    return np.array(rows, dtype=np.int64).reshape(-1, d)


def choose_evenly(count: int, most: int) -> Int64[np.ndarray, " chosen"]:
    """At most ``most`` of the numbers from 0 to ``count - 1``, evenly spaced, both ends among them."""
    return np.unique(np.linspace(0, count - 1, min(most, count)).round().astype(np.int64))
