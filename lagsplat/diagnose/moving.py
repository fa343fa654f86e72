"""A sim whose coefficients move along given rows: its rollouts over windows, and their exact slopes."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float64, Int64

from lagsplat.diagnose.forms import COEFFICIENTS, moved
from lagsplat.diagnose.kernel_sensitivity import sensitivities
from lagsplat.diagnose.model import Model
from lagsplat.diagnose.nuisance import Nuisance
from lagsplat.diagnose.record import Record, Windows
from lagsplat.diagnose.shoot import Data
from lagsplat.diagnose.simulate import Bench, functions_last


@dataclass(frozen=True)
class Columns:
    """Which coefficients are differentiated by: those that always move alike share a column."""

    of: tuple[np.ndarray, ...]
    """Column of each coefficient, shaped as these in the order of `COEFFICIENTS`, -1 where none moves it."""
    moves: Float64[np.ndarray, "n C"]
    """How far each move takes the coefficients of each column."""

    @classmethod
    def along(cls, moves: Float64[np.ndarray, "n K"], model: Model) -> "Columns":
        """Of the coefficients of ``model`` that ``moves`` change at all."""
        touched = np.flatnonzero(moves.any(axis=0))
        distinct, which = np.zeros((len(moves), 0)), np.zeros(0, np.int64)
        if len(touched):
            distinct, which = np.unique(moves[:, touched], axis=1, return_inverse=True)
        column = np.full(moves.shape[1], -1, np.int64)
        column[touched] = which.reshape(-1)
        return cls(tuple(_shaped(column, model)), distinct)


def _shaped(column: Int64[np.ndarray, " K"], model: Model) -> list[np.ndarray]:
    out, at = [], 0
    for name in COEFFICIENTS:
        value = getattr(model, name)
        out.append(functions_last(column[at : at + value.size].reshape(1, *value.shape))[0])
        at += value.size
    return out


@dataclass(frozen=True)
class Moving:
    """Rollouts of ``model`` over ``windows`` of a record, its coefficients moved along ``moves``."""

    model: Model
    record: Record
    windows: Windows
    moves: Float64[np.ndarray, "n K"]
    smooth: Float64[np.ndarray, "N d"]
    steps: int
    """Substeps between two frames."""
    held: bool
    """Inputs are held between samples instead of interpolated."""

    @cached_property
    def bench(self) -> Bench:
        """Nothing is uncertain but how far each move goes."""
        d, n_u = self.model.d, self.model.n_u
        nuisance = Nuisance(1.0, 1.0, 1.0, np.ones(d), 1.0, n_u, self.moves)
        return Bench(self.model, self.record, nuisance, self.steps, self.held, self.smooth)

    @cached_property
    def columns(self) -> Columns:
        """What is differentiated by."""
        return Columns.along(self.moves, self.model)

    def __call__(self, x: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Coordinates (P, W, L, d) for moves ``x`` (P, n) and starts (P, W, 2 d)."""
        fixed = self.bench.nuisance.size - len(self.moves)
        padded = np.concatenate([np.zeros((len(x), fixed)), x], axis=1)
        return self.bench.rollouts((), padded, starts, self.windows)[0]

    def derivatives(
        self, x: np.ndarray, starts: np.ndarray, data: Data
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As `lagsplat.diagnose.shoot.derivatives`, but exact, by the variational equations."""
        here, windows, n = moved(self.model, x @ self.moves), self.windows, self.columns.moves.shape[1]
        fields = [getattr(here, name) for name in COEFFICIENTS]
        used = max(len(field) for field in fields[:4])
        basis = here.basis.first(used)
        y = np.zeros(data.y.shape)
        slopes = np.zeros((*y.shape, n + starts.shape[1]))
        sensitivities(
            (basis.kind, basis.order, basis.centre, basis.scale),
            (*(functions_last(field[None])[0] for field in fields), here.width, here.rest), self.columns.of,
            n, np.ascontiguousarray(starts), windows.first, windows.length, self.record.time,
            self.bench.logged[0], self.steps, y, slopes,
        )  # fmt: skip
        slopes *= data.weight[..., None]
        flat = slopes.reshape(len(starts), -1, slopes.shape[-1])
        return (data.y - y) * data.weight, flat[..., :n] @ self.columns.moves.T, flat[..., n:]
