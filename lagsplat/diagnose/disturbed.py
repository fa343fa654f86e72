"""A sim's own recordings in which something acted that no column tells, as a push by hand: told without it.

A law that has to tell such a stretch as well tells none. The stretch that it misses most is left out, and the
law found anew; where that one tells the rest far better, it was the stretch that was wrong, and not the law.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float64, Int64

from lagsplat.diagnose.identify import Identified
from lagsplat.diagnose.record import Windows

MISSED = 4.0
"""Mean square residual, in that of the noise, above which it is asked."""
TOLD = 1.5
"""The same, below which all that is left is told."""
ODD = 4.0
"""Times the middle window's mean square by which one is missed that is left out."""
BETTER = 0.25
"""Share of the mean square that the others must leave at most."""
MOST, ONE_IN, LEAST = 3, 4, 8
"""Windows that are left out at most, one in how many at most, and of how many at least."""


def undisturbed(found: Identified, again: Callable[[Windows], Identified]) -> tuple[Identified, Windows]:
    """``found``, or what ``again`` finds on fewer of its windows, and the windows that were left out."""
    windows, best, n = found.windows, found, len(found.windows.first)
    kept = np.arange(n)
    for _ in range(min(MOST, n // ONE_IN) if found.misfit > MISSED and n >= LEAST else 0):
        missed = each(best)
        worst = int(np.argmax(missed))
        if best.misfit < TOLD or missed[worst] < ODD * np.median(missed):
            break
        kept = np.delete(kept, worst)
        best = again(windows.only(kept))
    if best.misfit < BETTER * found.misfit:
        return best, windows.only(np.setdiff1d(np.arange(n), kept))
    return found, windows.only(np.zeros(0, dtype=np.int64))


def each(found: Identified) -> Float64[np.ndarray, " W"]:
    """Mean square of every window's residual, in that of the noise."""
    length: Int64[np.ndarray, " W"] = found.windows.length
    return np.array([float((row[:n] ** 2).mean()) for row, n in zip(found.fit.residual, length, strict=True)])
