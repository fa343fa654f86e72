"""What keeps a polynomial law a mechanism while it is fitted."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.monomials import draw_states, evaluate_monomials
from lagsplat.stage2.likelihood.parameter_vector import MAP, POTENTIAL, VOLUMES, ParameterVector
from lagsplat.stage2.polynomials import CHECKED, REACH, PolynomialMap, measure_stretch

# The numbers below were set by hand, with both simulated arms, the rocker and the toy in view.
STATES, BEYOND = 256, 0.25  # points of the energy, and how far they lie beyond two states
FAR = 1e6  # where a spring alone is left [whitened units]
LEAST_STIFFNESS = 0.05  # there, where the mean stiffness is about 1
LACKING_STIFFNESS = 0.02  # standard deviation of what may lack
MAP_STATES, ADDED = 1024, 256  # points of the map, and how many are added where it has come near a fold
LEAST_STRETCH = 0.2  # smallest singular value of the map's Jacobian, which is the identity at q = 0
LACKING_STRETCH = 0.02  # standard deviation of what may lack


class Guard:
    """Points at which the map of a law must stay invertible and its energy stable.

    Where the loaded stiffness is positive between the states of the recording, there is one equilibrium at
    most. Without the guard, polynomials that fit the states bend down beside them, and maps fold.

    Args:
        parameters: of the law.
        trajectory: states and inputs; a point of the energy mixes two states, a little beyond both, and any
            input; one lies far outside.
        seed: of the points.
    """

    def __init__(self, parameters: ParameterVector, trajectory: EncodedTrajectory, *, seed: int) -> None:
        energy, coordinates = parameters.terms[0], parameters.coordinates
        q, u = trajectory.latents, trajectory.inputs
        self.eye = torch.eye(q.shape[1], dtype=torch.float64)
        around = draw_states(coordinates.ball, MAP_STATES, reach=REACH, seed=seed)
        self.slopes = evaluate_monomials(around, coordinates.exponents, ball=coordinates.ball)[1]
        rng = np.random.default_rng(seed)
        share = rng.uniform(-BEYOND, 1.0 + BEYOND, (STATES, 1))
        one, other = q[rng.integers(len(q), size=(2, STATES))]
        at = torch.from_numpy(np.clip(share * one + (1.0 - share) * other, q.min(axis=0), q.max(axis=0)))
        load = torch.from_numpy(rng.uniform(u.min(axis=0), u.max(axis=0), (STATES, u.shape[1])))
        with torch.no_grad():  # the stiffness is that at the points as the map is now
            at, _ = coordinates.evaluate(at)
        at, load = torch.cat([at, at[:1] + FAR]), torch.cat([load, load[:1]])
        (_, elastic), (_, pushed) = energy.differentiate_terms(at)
        loaded = -torch.einsum("nc,nkij->nckij", load, pushed).flatten(1, 2)
        self.curvatures = torch.cat([elastic, loaded], 1)  # of the energy
        self.of_map = parameters.find_columns(MAP)
        self.of_energy = parameters.find_columns(POTENTIAL, VOLUMES)

    def keep_folds(self, before: "Guard") -> None:
        """Take over the points of the map from a guard of the same polynomials."""
        if self.slopes.shape[1:] == before.slopes.shape[1:]:
            self.slopes = before.slopes

    def add_folds(self, coordinates: PolynomialMap) -> bool:
        """Add points at which a map has come near a fold in spite of the guard; whether there are any."""
        states = draw_states(coordinates.ball, CHECKED, reach=REACH, seed=0)
        stretch = measure_stretch(coordinates.evaluate(states)[1])[0]
        near = stretch.argsort()[:ADDED]
        near = near[stretch[near] < 0.5 * LEAST_STRETCH]
        slopes = evaluate_monomials(states[near], coordinates.exponents, ball=coordinates.ball)[1]
        self.slopes = torch.cat([self.slopes, slopes])
        return bool(len(near))

    def measure(self, theta: Float[Tensor, " p"]) -> tuple[Float[Tensor, " n"], Float[Tensor, "n p"]]:
        """What stiffness and stretch lack, in units of what may lack, and its derivatives by ``theta``."""
        stiffness = torch.einsum("k,nkij->nij", theta[self.of_energy], self.curvatures)
        values, vectors = torch.linalg.eigh(stiffness)
        weakest = vectors[:, :, 0]
        by_energy = torch.einsum("ni,nkij,nj->nk", weakest, self.curvatures, weakest)
        coefficients = theta[self.of_map].view(-1, len(self.eye))
        stretch, outer = measure_stretch(self.eye + torch.einsum("ki,nkl->nil", coefficients, self.slopes))
        by_map = torch.einsum("nil,nkl->nki", outer, self.slopes).flatten(1)
        lacking, rows = [], []
        for value, columns, by_column, least, unit in (
            (values[:, 0], self.of_energy, by_energy, LEAST_STIFFNESS, LACKING_STIFFNESS),
            (stretch, self.of_map, by_map, LEAST_STRETCH, LACKING_STRETCH),
        ):
            short = (least - value).clamp(min=0.0)
            row = theta.new_zeros(len(short), len(theta))
            row[:, columns] = -by_column * (short > 0.0)[:, None]
            lacking.append(short / unit)
            rows.append(row / unit)
        return torch.cat(lacking), torch.cat(rows)
