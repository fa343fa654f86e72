"""The small uncertainties of a simulator, which every hypothesis may use (nuisance parameters).

Their prior is narrow and centred at zero; an effect must explain more than these do.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.base import CoefficientBatch
from lagsplat.diagnose.mechanics.basis import POWER
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.mechanics.structure import COEFFICIENT_FIELDS, split_coefficients

MIN_INERTIA = 1e-3  # least factor on an inertia [1]; a trial step may go further than any fit stays


@dataclass(frozen=True)
class NuisanceParameters:
    """Standard deviations of the nuisance parameters, which are ordered as the fields.

    Parameters ``x`` (n,) are unknowns of a fit; zero is the simulator as it is.
    """

    potential: float  # relative error of the potential
    damping: float  # error of the damping rate [1/s]
    inputs: float  # relative error of each input's gain
    inertia: float
    """Relative error of the inertia along each coordinate; a single one's is that of all forces together."""
    offset: Float64[np.ndarray, " d"]
    """Constant acceleration along every coordinate [unit of the coordinate per s^2]."""
    warp: float  # curvature of the measurement, `y = q + warp (q - rest)^2 / scale`
    n_u: int  # number of inputs
    directions: Float64[np.ndarray, "R K"]
    """Changes of all coefficients that identification leaves open, each of one standard deviation."""

    @property
    def d(self) -> int:
        """Number of coordinates."""
        return len(self.offset)

    @property
    def counts(self) -> tuple[int, ...]:
        """Number of parameters of each field but the last, the directions."""
        return (1, 1, self.n_u, self.d if self.d > 1 else 0, self.d, self.d)

    @property
    def size(self) -> int:
        """Number of nuisance parameters."""
        return sum(self.counts) + len(self.directions)

    @property
    def deviation(self) -> Float64[np.ndarray, " n"]:
        """Standard deviations of all nuisance parameters."""
        one_each = (self.potential, self.damping, self.inputs, self.inertia, 1.0, self.warp)
        parts = [np.full(n, size) for n, size in zip(self.counts, one_each, strict=True)]
        parts[4] = self.offset
        return np.concatenate([*parts, np.ones(len(self.directions))])

    def freeze(self) -> "NuisanceParameters":
        """The same with all deviations close to zero, so that nothing is left uncertain."""
        tiny = 1e-6  # not zero, because fits divide by the deviations
        scaled = self.scale_mechanics(tiny)
        return replace(scaled, warp=tiny * self.warp, directions=tiny * self.directions)

    def scale_mechanics(self, factor: float) -> "NuisanceParameters":
        """The same with the mechanism's parameters ``factor`` times as uncertain, the measurement not."""
        return replace(
            self,
            potential=factor * self.potential,
            damping=factor * self.damping,
            inputs=factor * self.inputs,
            inertia=factor * self.inertia,
            offset=factor * self.offset,
        )

    def change_coefficients(self, model: MechanicalModel, x: Float64[np.ndarray, "P n"]) -> CoefficientBatch:
        """The model's coefficients under nuisance parameters ``x``."""
        potential, damping, inputs, inertia, offset, _, directions = self._split(x)
        fields = {name: np.repeat(getattr(model, name)[None], len(x), axis=0) for name in COEFFICIENT_FIELDS}
        if directions.shape[1]:
            moves = split_coefficients(directions @ self.directions, model)
            fields = {name: value + moves[name] for name, value in fields.items()}
        order, kind = model.basis.order, model.basis.kind
        is_linear = (kind == POWER) & (order.sum(axis=1) == 1)
        # The terms of the scaled coordinates themselves, in the order of the coordinates.
        linear = [int(np.flatnonzero(is_linear & (order[:, i] == 1))[0]) for i in range(model.d)]
        fields["potential"] = fields["potential"] * (1.0 + potential)
        fields["potential"][:, linear] -= offset * np.diag(model.inertia) * model.basis.scale
        fields["damping"][:, 0] += damping[:, :, None] * model.inertia
        if inertia.shape[1]:
            root = np.sqrt(np.maximum(1.0 + inertia, MIN_INERTIA))[:, None, :]
            fields["mass"] = fields["mass"] * root[..., None] * root[:, :, None]
        fields["input_map"] = fields["input_map"] * (1.0 + inputs)[:, None, :, None]
        return CoefficientBatch(**fields)

    def observe(self, y: np.ndarray, x: np.ndarray, model: MechanicalModel) -> np.ndarray:
        """The measurement of coordinates ``y`` (P, W, L, d) under nuisance parameters ``x`` (P, n)."""
        warp = self._split(x)[5]
        if not warp.any():
            return y
        # a diverged rollout is clipped, so that its square stays finite
        away = np.clip((y - model.rest) / model.basis.scale, -10.0, 10.0)
        return y + warp[:, None, None, :] * away**2 * model.basis.scale

    def _split(self, x: Float64[np.ndarray, "P n"]) -> list[np.ndarray]:
        """Columns of ``x`` by the field that they are parameters of."""
        return np.split(x, np.cumsum(self.counts), axis=1)
