"""The picture of a film at its mean state, how it changes with the state, and the noise of a colour.

All are of a local regression on the frames that were filmed near that state; no image model takes part.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float64

from lagsplat.array_types import Frames, Series
from lagsplat.matter.blurred_film import CameraFilm, blur_frames
from lagsplat.monomials import evaluate_monomials, list_exponents, make_wide_ball

FRAMES_PER_TERM = 8  # of the regression
DEGREE = 2  # of the regression


@dataclass(frozen=True)
class RestPicture:
    """What a local regression says of a film at the mean state.

    Args:
        color: the picture.
        slope: its derivative by each latent [1/whitened unit].
        noise: standard deviation of a colour about the regression.
    """

    color: Float[np.ndarray, "H W 3"]
    slope: Float64[np.ndarray, "d H W 3"]
    noise: float


def count_terms(d: int) -> int:
    """Number of terms of the regression."""
    return 1 + d + d * (d + 1) // 2


def find_nearest_frames(q: Series) -> np.ndarray:
    """The frames whose states are nearest to the mean state, as many as the regression asks for."""
    order = np.argsort(np.linalg.norm(q, axis=1), kind="stable")
    return order[: FRAMES_PER_TERM * count_terms(q.shape[1])]


def fit_rest_picture(colors: Float[np.ndarray, "n H W 3"], q: Series) -> RestPicture:
    """Fit the picture at the state zero to frames near it, by a polynomial of the second degree of the state.

    Frames count less the farther off their states are (tricube weights).

    Args:
        colors: of the frames from `find_nearest_frames`, blurred.
        q: their states [whitened units].

    Raises:
        ValueError: fewer frames than the regression has terms.

    Source: Cleveland, Robust Locally Weighted Regression, JASA 74 (1979).
    """
    n, d = q.shape
    terms, (height, width) = count_terms(d), colors.shape[1:3]
    if n <= 2 * terms:
        raise ValueError(
            f"the motion of matter needs more than {2 * terms} frames near the mean state for {d} "
            f"coordinates, and the film has {n}: record longer"
        )
    distance = np.linalg.norm(q, axis=1)
    weight = (1.0 - (distance / (1.001 * distance.max())) ** 3) ** 3
    exponents = list_exponents(d, lowest=0, highest=DEGREE)
    design = evaluate_monomials(torch.from_numpy(q), exponents, ball=make_wide_ball(d))[0].numpy()
    values = colors.reshape(n, -1).astype(np.float64)
    root = np.sqrt(weight)[:, None]
    solved, *_ = np.linalg.lstsq(root * design, root * values, rcond=None)
    rest = root * (values - design @ solved)
    free = weight.sum() * (1.0 - terms / n)
    variance = np.square(rest).sum(0) / free
    slope = solved[1 : 1 + d].reshape(d, height, width, 3)
    noise = float(np.sqrt(np.median(variance)))
    return RestPicture(solved[0].reshape(height, width, 3), slope, noise)


def show_mean_state(frames: Frames, q: Series) -> Float[np.ndarray, "H W 3"]:
    """The picture of a film at its mean state, with colours about [0, 1]."""
    near = np.sort(find_nearest_frames(q))
    colors, _ = blur_frames(CameraFilm(np.asarray(frames[near])), blur_px=0.0)
    return fit_rest_picture(colors, q[near]).color
