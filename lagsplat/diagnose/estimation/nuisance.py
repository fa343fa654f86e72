"""The small uncertainties of a simulator, which every hypothesis may use (nuisance parameters).

Their prior is narrow and centred at zero; an effect must explain more than these do.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.base import CoefficientBatch
from lagsplat.diagnose.mechanics.basis import POWER
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.mechanics.structure import COEFFICIENT_FIELDS


@dataclass(frozen=True)
class NuisanceParameters:
    """Standard deviations of the nuisance parameters, which are ordered as the fields.

    Parameters ``x`` (n,) are unknowns of a fit; zero is the simulator as it is.
    """

    potential: float  # relative error of the potential
    damping: float  # error of the damping rate [1/s]
    inputs: float  # relative error of each input's gain
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
    def size(self) -> int:
        """Number of nuisance parameters."""
        return 2 + self.n_u + 2 * self.d + len(self.directions)

    @property
    def deviation(self) -> Float64[np.ndarray, " n"]:
        """Standard deviations of all nuisance parameters."""
        return np.concatenate(
            [
                [self.potential, self.damping],
                np.full(self.n_u, self.inputs),
                self.offset,
                np.full(self.d, self.warp),
                np.ones(len(self.directions)),
            ]
        )

    def freeze(self) -> "NuisanceParameters":
        """The same with all deviations close to zero, so that nothing is left uncertain."""
        tiny = 1e-6  # not zero, because fits divide by the deviations
        return replace(
            self,
            potential=tiny * self.potential,
            damping=tiny * self.damping,
            inputs=tiny * self.inputs,
            offset=tiny * self.offset,
            warp=tiny * self.warp,
            directions=tiny * self.directions,
        )

    def scale_mechanics(self, factor: float) -> "NuisanceParameters":
        """The same with the mechanism's parameters ``factor`` times as uncertain, the measurement not."""
        return replace(
            self,
            potential=factor * self.potential,
            damping=factor * self.damping,
            inputs=factor * self.inputs,
            offset=factor * self.offset,
        )

    def names(self) -> tuple[str, ...]:
        """Names of all nuisance parameters."""
        return (
            "potential",
            "damping",
            *(f"input {i}" for i in range(self.n_u)),
            *(f"offset {i}" for i in range(self.d)),
            *(f"warp {i}" for i in range(self.d)),
            *(f"identification {i}" for i in range(len(self.directions))),
        )

    def change_coefficients(self, model: MechanicalModel, x: Float64[np.ndarray, "P n"]) -> CoefficientBatch:
        """The model's coefficients under nuisance parameters ``x``."""
        n, n_u, d = len(x), self.n_u, self.d
        fields = repeat_coefficients(model, n)
        tail = x[:, 2 + n_u + 2 * d :]
        if tail.shape[1]:
            fields = add_to_coefficients(fields, tail @ self.directions)
        potential = fields.potential * (1.0 + x[:, :1])
        lines = find_linear_terms(model)
        potential[:, lines] -= x[:, 2 + n_u : 2 + n_u + d] * np.diag(model.inertia) * model.basis.scale
        damping = fields.damping.copy()
        damping[:, 0] += x[:, 1, None, None] * model.inertia
        gains = 1.0 + x[:, 2 : 2 + n_u]
        return replace(
            fields,
            potential=potential,
            damping=damping,
            input_map=fields.input_map * gains[:, None, :, None],
        )

    def observe(self, y: np.ndarray, x: np.ndarray, model: MechanicalModel) -> np.ndarray:
        """The measurement of coordinates ``y`` (P, W, L, d) under nuisance parameters ``x`` (P, n)."""
        warp = x[:, 2 + self.n_u + self.d : 2 + self.n_u + 2 * self.d]
        if not warp.any():
            return y
        # a diverged rollout is clipped, so that its square stays finite
        away = np.clip((y - model.rest) / model.basis.scale, -10.0, 10.0)
        return y + warp[:, None, None, :] * away**2 * model.basis.scale


def find_linear_terms(model: MechanicalModel) -> np.ndarray:
    """Positions (d,) in the basis of the monomials that are the scaled coordinates themselves."""
    order, kind = model.basis.order, model.basis.kind
    first = (kind == POWER) & (order.sum(axis=1) == 1)
    return np.array([int(np.flatnonzero(first & (order[:, i] == 1))[0]) for i in range(model.d)])


def repeat_coefficients(model: MechanicalModel, n: int) -> CoefficientBatch:
    """The model's coefficients as a batch of ``n`` equal sets."""
    return CoefficientBatch(
        **{name: np.repeat(getattr(model, name)[None], n, axis=0) for name in COEFFICIENT_FIELDS}
    )


def add_to_coefficients(fields: CoefficientBatch, moves: Float64[np.ndarray, "P K"]) -> CoefficientBatch:
    """The coefficients with rows added that are ordered as `flatten_coefficients`."""
    values, at = {}, 0
    for name in COEFFICIENT_FIELDS:
        value = getattr(fields, name)
        size = value[0].size
        values[name] = value + moves[:, at : at + size].reshape(value.shape)
        at += size
    return CoefficientBatch(**values)
