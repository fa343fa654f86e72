"""What was pushed and what happened: one row a step, of which the last ones are kept."""

from collections import deque
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float64, Int64

from lagsplat.forces.loaded import Edits


@dataclass(frozen=True)
class Taped:
    """Rows of a session, ``dt_s`` apart; row ``i`` is the state before the step that row ``i`` drove.

    ``clip`` counts the resets before a row, where the state jumps. ``force`` [energy of the law per px]
    acts at ``place`` [px], NaN where nothing is held; ``load`` is the same pulled back. ``edits`` are the
    factors of damping, inertia and stiffness.
    """

    dt_s: float
    clip: Int64[np.ndarray, " N"]
    q: Float64[np.ndarray, "N d"]
    v: Float64[np.ndarray, "N d"]
    u: Float64[np.ndarray, "N n_u"]
    load: Float64[np.ndarray, "N d"]
    force: Float64[np.ndarray, "N n"]
    place: Float64[np.ndarray, "N n"]
    edits: Float64[np.ndarray, "N 3"]
    energy: Float64[np.ndarray, "N 5"]
    """Kinetic, potential, work of the hand, work of the inputs, dissipated."""

    def __len__(self) -> int:
        return len(self.q)

    @property
    def time_s(self) -> Float64[np.ndarray, " N"]:
        """Instants of the rows, the first at 0."""
        return self.dt_s * np.arange(len(self))

    @property
    def segments(self) -> tuple[tuple[int, int], ...]:
        """Rows between resets, half-open."""
        cuts = [0, *(1 + np.flatnonzero(np.diff(self.clip))).tolist(), len(self)]
        return tuple((a, b) for a, b in pairwise(cuts) if a < b)

    def edits_at(self, row: int) -> Edits:
        """The edits of a row."""
        damping, inertia, stiffness = (float(x) for x in self.edits[row])
        return Edits(damping=damping, inertia=inertia, stiffness=stiffness)


class Tape:
    """Keeps the last ``rows`` rows; older ones are dropped, so that memory is bounded."""

    def __init__(self, *, d: int, n_u: int, space: int, dt_s: float, rows: int) -> None:
        self.d, self.n_u, self.space, self.dt_s = d, n_u, space, dt_s
        self.rows: deque[np.ndarray] = deque(maxlen=max(1, rows))

    def __len__(self) -> int:
        return len(self.rows)

    def add(self, clip: int, *parts: np.ndarray) -> None:
        """One row: the parts of `Taped` in their order, after ``clip``."""
        self.rows.append(np.concatenate([[clip], *parts]))

    def read(self) -> Taped:
        """What is kept.

        Raises:
            ValueError: nothing happened yet.
        """
        if not self.rows:
            raise ValueError("nothing has been recorded yet: let the simulation run, push it, and save again")
        table = np.stack(list(self.rows))
        widths = [1, self.d, self.d, self.n_u, self.d, self.space, self.space, 3, 5]
        clip, *parts = np.split(table, np.cumsum(widths)[:-1], axis=1)
        return Taped(self.dt_s, clip[:, 0].astype(np.int64), *(part.copy() for part in parts))
