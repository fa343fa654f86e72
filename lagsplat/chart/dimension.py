"""Intrinsic dimension of the encoded trajectory, a check on the chosen d."""

import numpy as np
from skdim.id import MLE

from lagsplat.shapes import Series


def intrinsic_dimension(q: Series, *, frames: int, neighbours: int, seed: int) -> float:
    """Maximum-likelihood dimension of a random subsample of whitened latents.

    One coordinate has dimension 1 by definition and is not estimated. The estimate depends on the scale of
    the neighbourhood: noise raises it, a coordinate that hardly moves lowers it.

    Raises:
        ValueError: fewer frames than neighbours.

    Source: Levina and Bickel 2004; https://doi.org/10.3390/e23101368 (scikit-dimension).
    """
    if q.shape[1] == 1:
        return 1.0
    if len(q) <= neighbours:
        raise ValueError(
            f"{len(q)} training frames are too few for chart.dimension_neighbours={neighbours}: lower it"
        )
    rng = np.random.default_rng(seed)
    sample = q[rng.choice(len(q), min(frames, len(q)), replace=False)]
    local = MLE().fit_transform_pw(sample, n_neighbors=neighbours)
    return float(1.0 / np.mean(1.0 / local[np.isfinite(local) & (local > 0)]))
