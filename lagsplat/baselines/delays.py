"""Inputs with their recent past, as both laws of motion take them."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64


def delayed(
    inputs: Float64[np.ndarray, "T c"], *, samples: int, segments: Sequence[tuple[int, int]]
) -> Float64[np.ndarray, "T m"]:
    """The last ``samples`` inputs of each frame, oldest first, m = samples c; channels stay together.

    Before the start of a clip its first input is repeated. Delays are made on the whole recording, so that
    the first held-out frame knows what came before it.
    """
    rows = np.empty((len(inputs), samples * inputs.shape[1]))
    for start, stop in segments:
        frames = np.arange(start, stop)
        past = [inputs[np.maximum(frames - back, start)] for back in range(samples - 1, -1, -1)]
        rows[start:stop] = np.concatenate(past, axis=1)
    return rows


def standing(inputs: Float64[np.ndarray, "T c"], *, samples: int) -> Float64[np.ndarray, "T m"]:
    """The same as if the input of each frame had always been there."""
    return np.tile(inputs, (1, samples))
