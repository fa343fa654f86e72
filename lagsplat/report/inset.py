"""Where a predicted render differs from the encoded one by more than reconstruction, and by how far."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter
from scipy.ndimage import shift as translate
from skimage.registration import phase_cross_correlation
from skimage.transform import resize

INSET = 0.28
UPSAMPLING = 50
ALIGNMENTS = 5
Picture = Float[np.ndarray, "H W 3"]


@dataclass(frozen=True)
class Inset:
    """Window (row, column, side in render pixels) and what the prediction does in it.

    ``shift_px`` (down, right) is its shift against the encoding, in render pixels. ``ratio`` is the mean
    absolute difference of the two renders over that of the render at the encoded state and the recording.
    """

    row: int
    column: int
    side: int
    shift_px: tuple[float, float]
    ratio: float


def choose_inset(
    at_encoded: Picture, at_predicted: Picture, reconstruction_error: Float[np.ndarray, "h w"]
) -> Inset:
    """The window where the two renders differ most in excess of what the autoencoder gets wrong there.

    ``reconstruction_error`` is the mean absolute error of the render at the encoded state, at the recorded
    resolution. Both are averaged under the window, by the same Gaussian, before one is taken from the other.

    Source: paper, Reading the rollout figures.
    """
    height, width = at_encoded.shape[:2]
    side = max(round(INSET * min(height, width)), 8)
    moved = np.abs(at_predicted - at_encoded).mean(axis=2)
    wrong = resize(reconstruction_error, (height, width), order=1, mode="edge", anti_aliasing=False)
    excess = gaussian_filter(moved - wrong, side / 4)
    half = side // 2
    inner = excess[half : height - side + half + 1, half : width - side + half + 1]
    row, column = np.unravel_index(int(np.argmax(inner)), inner.shape)
    window = (slice(row, row + side), slice(column, column + side))
    shift = measured_shift(at_encoded[window].mean(axis=2), at_predicted[window].mean(axis=2))
    ratio = float(moved[window].mean() / max(wrong[window].mean(), 1e-12))
    return Inset(int(row), int(column), side, shift, ratio)


def measured_shift(
    reference: Float[np.ndarray, "h w"], moved: Float[np.ndarray, "h w"]
) -> tuple[float, float]:
    """How far (down, right) ``moved`` lies from ``reference``, in pixels; zero without any structure.

    The taper that hides the window's edges also pulls the estimate towards zero, so ``moved`` is shifted back
    by what was found and the rest is measured again.
    """
    taper = np.outer(np.hanning(reference.shape[0]), np.hanning(reference.shape[1]))
    first = (reference - reference.mean()) * taper
    total = np.zeros(2)
    for _ in range(ALIGNMENTS):
        back = translate(moved, -total, order=1, mode="nearest")
        second = (back - back.mean()) * taper
        if min(np.ptp(first), np.ptp(second)) < 1e-6:
            return 0.0, 0.0
        step, _, _ = phase_cross_correlation(first, second, upsample_factor=UPSAMPLING, normalization=None)
        total = total - step
    return float(total[0]), float(total[1])
