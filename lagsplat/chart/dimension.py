"""Intrinsic dimension of the encoded trajectory, a check on the chosen d."""

import numpy as np
from skdim.id import MLE

from lagsplat.shapes import Series


def intrinsic_dimension(q: Series, *, frames: int, neighbours: int, seed: int) -> float:
    """Maximum-likelihood dimension of a random subsample of whitened latents.

    One coordinate has dimension 1 by definition and is not estimated. The estimate depends on the scale of
    the neighbourhood: noise raises it, a coordinate that hardly moves lowers it.

    Raises:
        ValueError: fewer different frames than neighbours.

    Source: Levina and Bickel 2004; https://doi.org/10.3390/e23101368 (scikit-dimension).
    """
    if q.shape[1] == 1:
        return 1.0
    rng = np.random.default_rng(seed)
    # Equal frames, at rest say, have no distance to take the logarithm of.
    sample = np.unique(q[rng.choice(len(q), min(frames, len(q)), replace=False)], axis=0)
    if len(sample) <= neighbours:
        raise ValueError(
            f"{len(sample)} different training frames are too few for "
            f"chart.dimension_neighbours={neighbours}: lower it"
        )
    local = MLE().fit_transform_pw(sample, n_neighbors=neighbours)
    return float(1.0 / np.mean(1.0 / local[np.isfinite(local) & (local > 0)]))
