"""Every picture shifted back onto the first one, by the motion of the background."""

from collections.abc import Iterable

import cv2
import numpy as np
from jaxtyping import Float64, UInt8

from lagsplat.io.background import background_path


def path_to_undo(pictures: Iterable[UInt8[np.ndarray, "h w"]], *, source: str) -> Float64[np.ndarray, "T 2"]:
    """Shift (x, y) of the background in each grey picture since the first [pixel].

    Raises:
        ValueError: the background cannot be measured, in all pictures or in one.
    """
    path = background_path(pictures)
    if path is None:
        raise ValueError(
            f"{source}: recording.stabilise needs a background that can be followed, and too few corners "
            "that stand still or move alike were found over the picture; set recording.stabilise=false, or "
            "film with something textured behind the system"
        )
    hidden = np.flatnonzero(np.isnan(path[:, 0]))
    if hidden.size:
        raise ValueError(
            f"{source}: recording.stabilise cannot follow the background in {hidden.size} of {len(path)} "
            f"frames, the first of them frame {hidden[0]} of those kept; cut them off with recording.skip_s "
            "and end_s, or set recording.stabilise=false"
        )
    return path


def shift_back(
    picture: UInt8[np.ndarray, "h w 3"], moved: Float64[np.ndarray, " 2"]
) -> UInt8[np.ndarray, "h w 3"]:
    """``picture`` as it would be had it not moved by (x, y) [pixel]; its border is continued outwards.

    Only shifts are undone, by cubic interpolation: no turns, and no change of scale.
    """
    back = np.array([[1.0, 0.0, moved[0]], [0.0, 1.0, moved[1]]])
    return cv2.warpAffine(
        picture,
        back,
        (picture.shape[1], picture.shape[0]),
        flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_REPLICATE,
    )
