"""Where a mechanism was seen: the states and inputs at which a sim that is given pointwise is asked."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.record import Record

MARGIN = 0.15
"""How far beyond what was visited a sim is asked, as a share of half the range."""
POINTS = 600


@dataclass(frozen=True)
class Region:
    """States and inputs, a row each: visited ones, and as many that mix what never came together."""

    q: Float64[np.ndarray, "N d"]
    v: Float64[np.ndarray, "N d"]
    u: Float64[np.ndarray, "N n_u"]

    @property
    def d(self) -> int:
        """Number of coordinates."""
        return self.q.shape[1]

    @property
    def n_u(self) -> int:
        """Number of inputs."""
        return self.u.shape[1]

    @property
    def speed(self) -> Float64[np.ndarray, " d"]:
        """Root mean square of the velocities [1/s]."""
        return np.sqrt(np.mean(self.v**2, axis=0))


def region_of(record: Record, *, n: int | None = None, seed: int = 0) -> Region:
    """About ``n`` points in the region of a record and `MARGIN` around it, by default `POINTS` and as many
    more for each coordinate.

    An input or a rate that never changes is varied by its own size, or by one, so that what it does can be
    told.
    """
    rng = np.random.default_rng(seed)
    half = max((POINTS * (1 + record.d) if n is None else n) // 2, 1)
    visited = np.linspace(0, len(record.q) - 1, min(half, len(record.q))).astype(int)
    drawn = rng.integers(len(record.q), size=(3, half))

    def around(x: np.ndarray, mixed: np.ndarray) -> np.ndarray:
        low, high = x.min(axis=0), x.max(axis=0)
        centre, reach = 0.5 * (low + high), 0.5 * (high - low)
        still = reach <= 1e-9 * np.maximum(np.abs(centre), 1e-9)
        own = np.where(still, np.where(np.abs(centre) > 0.0, np.abs(centre), 1.0), reach)
        near = x[mixed] + own * np.where(still, 1.0, MARGIN) * rng.uniform(-1.0, 1.0, (half, x.shape[1]))
        return np.concatenate([centre + (1.0 + MARGIN) * (x[visited] - centre), near])

    return Region(around(record.q, drawn[0]), around(record.v, drawn[1]), around(record.u, drawn[2]))
