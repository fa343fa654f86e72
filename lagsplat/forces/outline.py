"""Where the object is seen to end: for the eye, cut out by colour."""

import cv2
import numpy as np
from jaxtyping import Bool, Float

from lagsplat.forces.scene import OUTLINE, STILL, Scene

CORE = 0.9
"""Of the largest motion around: what moves as much is the object for certain."""
CUTS = 5
FOREGROUND = (cv2.GC_FGD, cv2.GC_PR_FGD)


def outlined(picture: Float[np.ndarray, "h w 3"], scene: Scene) -> Bool[np.ndarray, "h w"]:
    """Which pixels show the object, for the eye alone: cut out by colour from what moves most around it.

    Source: Rother, Kolmogorov and Blake, "GrabCut", ACM Transactions on Graphics 23 (2004), as in OpenCV.
    """
    columns_rows = picture.shape[1::-1]
    near, moves = (
        cv2.resize(part.astype(np.float32), columns_rows, interpolation=cv2.INTER_LINEAR)
        for part in (scene.relative, scene.motion)
    )
    labels = np.where(near > OUTLINE, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    labels[near > CORE] = cv2.GC_FGD
    labels[moves < STILL] = cv2.GC_BGD
    if not (np.isin(labels, FOREGROUND).any() and (~np.isin(labels, FOREGROUND)).any()):
        return near > OUTLINE
    cv2.setRNGSeed(0)
    levels = (255 * picture.clip(0.0, 1.0)).astype(np.uint8)
    ground, thing = np.zeros((1, 65)), np.zeros((1, 65))
    cv2.grabCut(levels, labels, (0, 0, 1, 1), ground, thing, CUTS, cv2.GC_INIT_WITH_MASK)
    return np.isin(labels, FOREGROUND)
