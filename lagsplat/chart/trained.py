"""Refusing an autoencoder that learned nothing, before hours are spent on its latents."""

import numpy as np

from lagsplat.shapes import Frames
from lagsplat.stage1.autoencoder import Autoencoder, decode_latents, encode_frames, to_images

SAMPLE = 256  # frames, evenly spaced over the clip
LARGEST_SHARE = 0.5  # of the variance of the frames that a reconstruction may leave


def require_trained(autoencoder: Autoencoder, frames: Frames) -> None:
    """Compare the reconstructions of some frames with the mean of these frames.

    Raises:
        ValueError: they leave more than half of the variance over time. The latents then say little about
            the motion.
    """
    at = np.unique(np.linspace(0, len(frames) - 1, SAMPLE).astype(int))
    seen = np.asarray(frames[at])
    images = to_images(seen).double().numpy()
    error = float(np.square(decode_latents(autoencoder, encode_frames(autoencoder, seen)) - images).mean())
    variance = float(images.var(0).mean())
    if error > LARGEST_SHARE * variance:
        raise ValueError(
            "stage 1 learned nothing to build on: it draws the training frames with a mean squared error of "
            f"{error:.2e}, and their mean alone would err by {variance:.2e}. Look at reconstruction.png, "
            "then raise stage1.steps, lower system.encoder_rate or take another seed"
        )
