"""Priors of the parameters of a polynomial law, whose widths the recording tells.

A law is linear unless the recording says otherwise. Its other terms fall into groups: the map, the frame of
mass and damping, the potential and the inputs. Each group has a normal prior about zero whose precision, the
relevance of the group, maximises the evidence. Groups that explain nothing vanish so. Within a group a
monomial ``q^a`` has the standard deviation that it has in a random function with the covariance
``exp(-|q - q'|^2 / (2 l^2))``, which makes high degrees small; ``l`` is the edge of the data.

Source: MacKay 1992, DOI 10.1162/neco.1992.4.3.415 (evidence); Tipping and Faul 2003, "Fast marginal
likelihood maximisation for sparse Bayesian models" (groups that are absent); Cotter et al. 2011,
arXiv:1109.4603 (monomials of the Gaussian kernel).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Float64, Int
from scipy.linalg import cho_factor, cho_solve
from torch import Tensor

from lagsplat.stage2.likelihood.parameter_vector import FRAME, MAP, POTENTIAL, VOLUMES, ParameterVector

# The numbers below were set by hand, with the seven simulated recordings in view.
VAGUE = 1e-2  # precision of the coefficients of a linear law
EDGE = 3.0  # of the data [standard deviations]
ABSENT = 1e8  # relevance of a group that explains nothing
MOST, LEAST = 1e6, 1e-3  # of the others
FASTEST = 10.0  # change of a relevance in a step
TRIED = 10.0 ** np.arange(-2.0, 5.5, 0.5)  # for an absent group


@dataclass(frozen=True)
class Prior:
    """A normal prior, independent for each parameter.

    Args:
        mean: of the parameters.
        unit: precision where the relevance is one.
        groups: places of the parameters of each group; all others keep their ``unit``.
        relevance: factor on the precision of each group.
    """

    mean: Float64[np.ndarray, " p"]
    unit: Float64[np.ndarray, " p"]
    groups: Sequence[Int[np.ndarray, " n"]]
    relevance: Float64[np.ndarray, " g"]

    @property
    def precision(self) -> Float64[np.ndarray, " p"]:
        """Of each parameter."""
        precision = self.unit.copy()
        for group, relevance in zip(self.groups, self.relevance, strict=True):
            precision[group] *= relevance
        return precision

    def estimate_relevance(
        self, theta: Float64[np.ndarray, " p"], information: Float64[np.ndarray, "p p"]
    ) -> "Prior":
        """The prior a step nearer to the largest evidence; absent groups stay so.

        Args:
            theta: the most likely parameters.
            information: second derivative of the misfit there, with this prior.
        """
        variance, precision = np.diag(np.linalg.inv(information)), self.precision
        relevance = self.relevance.copy()
        for i, group in enumerate(self.groups):
            if relevance[i] == ABSENT:
                continue
            determined = max(float(np.sum(1.0 - precision[group] * variance[group])), 1e-3)
            size = float(np.sum(self.unit[group] * np.square(theta[group])))
            wanted = determined / max(size, 1e-12)
            wanted = float(np.clip(wanted, relevance[i] / FASTEST, relevance[i] * FASTEST))
            relevance[i] = ABSENT if wanted > MOST else max(wanted, LEAST)
        return replace(self, relevance=relevance)

    def without_absent(self) -> "Prior":
        """The prior that says nothing of absent groups, under which their information shows."""
        return replace(self, relevance=np.where(self.relevance == ABSENT, 0.0, self.relevance))

    def add_group(
        self, information: Float64[np.ndarray, "p p"], right: Float64[np.ndarray, " p"], *, least_gain: float
    ) -> "Prior | None":
        """The prior with the absent group that raises the evidence most, or None if that is too little.

        Args:
            information: second derivative of the misfit, with `without_absent`.
            right: what the misfit falls by along each parameter.
            least_gain: of the logarithm of the evidence [nat].
        """
        absent = np.flatnonzero(self.relevance == ABSENT).tolist()
        present = np.ones(len(right), dtype=bool)
        for i in absent:
            present[self.groups[i]] = False
        try:
            factor = cho_factor(information[np.ix_(present, present)])
        except np.linalg.LinAlgError:
            return None
        best = (least_gain, -1, ABSENT)
        for i in absent:
            group = self.groups[i]
            across = information[np.ix_(present, group)]
            solved = cho_solve(factor, across)
            scale = 1.0 / np.sqrt(self.unit[group])  # parameters of unit size where the relevance is one
            inner = scale[:, None] * (information[np.ix_(group, group)] - across.T @ solved) * scale
            slope = scale * (right[group] - solved.T @ right[present])
            values, vectors = np.linalg.eigh(inner)
            values, along = np.maximum(values, 0.0), np.square(vectors.T @ slope)
            for relevance in TRIED:
                gain = 0.5 * float(np.sum(along / (values + relevance) - np.log1p(values / relevance)))
                best = max(best, (gain, i, relevance))
        if best[1] < 0:
            return None
        relevance = self.relevance.copy()
        relevance[best[1]] = best[2]
        return replace(self, relevance=relevance)


def make_prior(parameters: ParameterVector, relevance: Float64[np.ndarray, " g"] | None = None) -> Prior:
    """A prior that is vague about the linear part of a law, and expects it as it is.

    The relevance of all groups is one by default.
    """
    energy, mass, _ = parameters.terms
    bends = parameters.coordinates.exponents
    scales = {
        # by the Jacobian, which is one at the middle
        MAP: (bends.sum(1) / EDGE * _scale(bends))[:, None],
        FRAME: _scale(mass.frame.exponents)[:, None, None],
        POTENTIAL: _scale(energy.exponents),
        VOLUMES: _scale(energy.input_exponents),
    }
    theta = parameters.read().numpy()
    mean, unit = theta.copy(), np.full(len(theta), VAGUE)
    groups = {name: group.numpy() for name, group in parameters.list_groups().items()}
    for name, group in groups.items():
        scale = np.zeros(len(theta))
        scale[parameters.find_columns(name)] = scales[name].expand(parameters.parts[name].shape).reshape(-1)
        unit[group], mean[group] = scale[group] ** 2, 0.0
    places = list(groups.values())
    return Prior(mean, unit, places, np.ones(len(places)) if relevance is None else relevance)


def _scale(exponents: Float[Tensor, "k d"]) -> Float[Tensor, " k"]:
    """Reciprocal standard deviations of monomials: ``l^|a| sqrt(a!)``."""
    return torch.exp(exponents.sum(1) * np.log(EDGE) + 0.5 * torch.lgamma(exponents + 1.0).sum(1))
