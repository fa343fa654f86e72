"""The map into coordinates in which a driven motion is the linear response to its inputs.

An encoder that bends the coordinates of a mechanism bends every term of its law. Where the inputs tell which
functions of the latents answer them linearly, the coordinates are known before the law is.
"""

import numpy as np
import torch

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.monomials import enclose_states, evaluate_monomials
from lagsplat.stage1.linear_response import InputHistory, fit_linear_response
from lagsplat.stage2.likelihood.guard import LEAST_STRETCH
from lagsplat.stage2.polynomials import PolynomialMap

# The numbers below were set by hand.
FOLLOWED = 8192  # frames whose latents are compared with the inputs
SHRUNK = 0.8  # factor of a map that folds


def fit_response_map(trajectory: EncodedTrajectory, *, degree: int) -> PolynomialMap | None:
    """Find polynomials of the latents that linear filters of the inputs explain best.

    They are turned and scaled so that the map is the identity to first order where the latents are zero. A
    map that folds, or nearly so, where no data are is drawn back towards the identity until it does not.
    The result is None where filters of the inputs do not explain the latents.

    Args:
        trajectory: latents as encoded, and inputs.
        degree: of the polynomials.

    Source: canonical correlations, see `lagsplat.stage1.linear_response`.
    """
    q, d = torch.from_numpy(trajectory.latents), trajectory.latents.shape[1]
    coordinates = PolynomialMap(d, degree=degree, ball=enclose_states(q))
    frames = np.concatenate([np.arange(start, stop) for start, stop in trajectory.segments])
    frames = frames[np.unique(np.linspace(0, len(frames) - 1, FOLLOWED).astype(int))]
    bends, _ = evaluate_monomials(q[frames], coordinates.exponents, ball=coordinates.ball)
    history = InputHistory(trajectory.inputs, trajectory.segments).before(frames)
    response = fit_linear_response(np.c_[trajectory.latents[frames], bends.numpy()], history, d)
    if response is None:
        return None
    linear, bent = response.weights[:d], response.weights[d:]
    with torch.no_grad():
        coordinates.coefficients.copy_(torch.from_numpy(bent @ np.linalg.pinv(linear)))
        while coordinates.measure_least_stretch() < LEAST_STRETCH:
            coordinates.coefficients.mul_(SHRUNK)
    return coordinates
