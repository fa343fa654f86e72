"""The object as it is seen at rest: matter, without ground of one colour that seems to move along with it."""

import cv2
import numpy as np
import torch
from jaxtyping import Bool, Float
from scipy.ndimage import binary_closing, binary_dilation, binary_fill_holes

from lagsplat.forces.moving_parts import find_moving_parts
from lagsplat.forces.operating_point import OperatingPoint

STATES = 24  # recorded states at which the ground behind the object is looked for
UNLIKE = 0.12  # difference of colours (0 to 1) from which a pixel shows other than the ground
LEAST = 0.5  # share of the matter that is left at least; with less, the object looks like its ground


def find_rest_mask(point: OperatingPoint) -> Bool[np.ndarray, "H W"]:
    """Find the pixels that show the moving object at rest.

    Those are pixels of matter that look unlike the ground that recorded states show there once the object has
    moved away, or that it never leaves.
    """
    matter = point.find_moving_parts().object
    recorded = point.chart.train.latents
    rows = np.unique(np.linspace(0, len(recorded) - 1, STATES).astype(int))
    states = torch.cat([point.rest[None], torch.from_numpy(recorded[rows]).to(point.rest)])
    images = point.render_images(states)
    ground = np.ma.median(np.ma.masked_array(images[1:], mask=_cover(point, states[1:], images)), axis=0)
    known = ~np.ma.getmaskarray(ground).any(2)
    unlike = np.abs(images[0] - ground.filled(0.0)).max(2) > UNLIKE
    shown = binary_fill_holes(binary_closing(matter & (unlike | ~known))) & matter
    return shown if shown.sum() > LEAST * matter.sum() else matter


def _cover(
    point: OperatingPoint, states: torch.Tensor, images: Float[np.ndarray, "n H W 3"]
) -> Bool[np.ndarray, "m H W 3"]:
    """Pixels that matter covers at each state, with a rim."""
    height, width, lens = point.height, point.width, point.autoencoder.lens
    scenes = (find_moving_parts(point.matter, q, height=height, width=width, lens=lens) for q in states)
    covered = [binary_dilation(scene.object) for scene in scenes]
    return np.broadcast_to(np.stack(covered)[..., None], images[1:].shape)


def draw_rest_mask(point: OperatingPoint, *, scale: int) -> Bool[np.ndarray, "h w"]:
    """The same in a picture ``scale`` times as large, with a smooth boundary."""
    return enlarge_mask(find_rest_mask(point), scale=scale)


def enlarge_mask(mask: Bool[np.ndarray, "H W"], *, scale: int) -> Bool[np.ndarray, "h w"]:
    """Enlarge a mask and smooth its boundary."""
    height, width = mask.shape
    size = (scale * width, scale * height)
    smooth = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_CUBIC)
    return cv2.GaussianBlur(smooth, (0, 0), 0.5 * scale) > 0.5
