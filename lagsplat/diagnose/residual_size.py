"""How large a residual force is, and against what: the measure in which every share is counted."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.smoother import Smoothed


def swing_acceleration(smoothed: Sequence[Smoothed]) -> Float64[np.ndarray, " d"]:
    """Root mean square of each coordinate's acceleration, the unit of its residual."""
    return np.sqrt(np.mean(np.concatenate([one.a for one in smoothed]) ** 2, axis=0))


def energies(smoothed: Sequence[Smoothed]) -> list[Float64[np.ndarray, "T d"]]:
    """Squared residual of each sample of each motion, over the swing's; zero where no force was kept."""
    unit = swing_acceleration(smoothed)
    return [np.where(one.active, (one.residual / unit) ** 2, 0.0) for one in smoothed]


def coordinate_shares(smoothed: Sequence[Smoothed]) -> Float64[np.ndarray, " d"]:
    """Share of the residual in each coordinate, summing to one; zeros where there is no residual."""
    total = np.sum([energy.sum(axis=0) for energy in energies(smoothed)], axis=0)
    return total / total.sum() if total.sum() > 0.0 else total
