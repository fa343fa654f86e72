"""A recording as every method gets it: nominal and real motions, and nothing else."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

from lagsplat.io.trajectory.trajectory import Trajectory, read_trajectory_file


@dataclass(frozen=True)
class Case:
    """Nominal and real motions, and a number that depends on their content alone."""

    sim: tuple[Trajectory, ...]
    real: tuple[Trajectory, ...]
    seed: int

    @property
    def d(self) -> int:
        """Number of coordinates."""
        return self.real[0].d


def open_case(place: Path) -> Case:
    """The recording in a folder of ``sim_*.csv`` and ``real_*.csv``.

    Raises:
        ValueError: one of the sides has no file, or a file is no motion.
    """
    sides = [sorted(place.glob(pattern)) for pattern in ("sim_*.csv", "real_*.csv")]
    if not all(sides):
        raise ValueError(f"{place}: a recording needs sim_*.csv and real_*.csv")
    digest = hashlib.sha256(b"".join(path.read_bytes() for side in sides for path in side)).digest()
    sim, real = (tuple(read_trajectory_file(path) for path in side) for side in sides)
    return Case(sim, real, int.from_bytes(digest[:8], "big"))
