"""The small uncertainties of a sim, which every hypothesis may use: how far its parameters wander.

They are believed to be near zero; an effect must explain more than moving these does.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.effects.base import CoefficientBatch
from lagsplat.diagnose.mechanics.model import MechanicalModel


@dataclass(frozen=True)
class NuisanceParameters:
    """Standard deviations of the uncertainties, in this order: potential, damping, inputs, offset, warp.

    The potential and each input may be off by a share; the damping by a rate [1/s]; a constant acceleration
    may act along every coordinate; what is seen may be bent, ``y = q + warp (q - rest)^2 / scale``.
    ``directions`` are changes of all coefficients that the sim's identification leaves open, each of one
    standard deviation.
    """

    potential: float
    damping: float
    inputs: float
    offset: Float64[np.ndarray, " d"]
    warp: float
    n_u: int
    directions: Float64[np.ndarray, "R K"]

    @property
    def d(self) -> int:
        """Number of coordinates."""
        return len(self.offset)

    @property
    def size(self) -> int:
        """Number of uncertainties."""
        return 2 + self.n_u + 2 * self.d + len(self.directions)

    @property
    def deviation(self) -> Float64[np.ndarray, " n"]:
        """Their standard deviations."""
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
        """The same with nothing left uncertain."""
        tiny = 1e-6
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
        """The same with the mechanism's own parameters ``factor`` times as uncertain; what is seen is not."""
        return replace(
            self,
            potential=factor * self.potential,
            damping=factor * self.damping,
            inputs=factor * self.inputs,
            offset=factor * self.offset,
        )

    def names(self) -> tuple[str, ...]:
        """What each of them is."""
        return (
            "potential",
            "damping",
            *(f"input {i}" for i in range(self.n_u)),
            *(f"offset {i}" for i in range(self.d)),
            *(f"warp {i}" for i in range(self.d)),
            *(f"identification {i}" for i in range(len(self.directions))),
        )

    def fields(self, model: MechanicalModel, x: Float64[np.ndarray, "P n"]) -> CoefficientBatch:
        """The sim's coefficients, moved by ``x``."""
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
        """What is seen of coordinates ``y`` (P, W, L, d)."""
        warp = x[:, 2 + self.n_u + self.d : 2 + self.n_u + 2 * self.d]
        if not warp.any():
            return y
        away = np.clip((y - model.rest) / model.basis.scale, -10.0, 10.0)
        return y + warp[:, None, None, :] * away**2 * model.basis.scale


def find_linear_terms(model: MechanicalModel) -> np.ndarray:
    """Positions in the basis of the coordinates themselves, (d,)."""
    order, kind = model.basis.order, model.basis.kind
    first = (kind == 0) & (order.sum(axis=1) == 1)
    return np.array([int(np.flatnonzero(first & (order[:, i] == 1))[0]) for i in range(model.d)])


def repeat_coefficients(model: MechanicalModel, n: int) -> CoefficientBatch:
    """The sim's coefficients, ``n`` times."""
    return CoefficientBatch(
        **{
            name: np.repeat(getattr(model, name)[None], n, axis=0)
            for name in CoefficientBatch.__dataclass_fields__
        }
    )


def flatten_coefficients(model: MechanicalModel) -> Float64[np.ndarray, " K"]:
    """All coefficients of a sim in one row."""
    return np.concatenate([getattr(model, name).ravel() for name in CoefficientBatch.__dataclass_fields__])


def add_to_coefficients(fields: CoefficientBatch, moves: Float64[np.ndarray, "P K"]) -> CoefficientBatch:
    """Coefficients moved by rows that are ordered as `flatten_coefficients`."""
    out, at = {}, 0
    for name in CoefficientBatch.__dataclass_fields__:
        value = getattr(fields, name)
        size = value[0].size
        out[name] = value + moves[:, at : at + size].reshape(value.shape)
        at += size
    return CoefficientBatch(**out)
