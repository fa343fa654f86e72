"""Which frames of a recording are held out."""

import math
from collections.abc import Sequence
from dataclasses import replace

from lagsplat.io.config import SplitConfig
from lagsplat.io.recording import LEAST_FRAMES, Recording


def divide(recording: Recording, split: SplitConfig) -> Recording:
    """The recording with its ``n_train`` set: the end of it is held out, as ``split`` says.

    Raises:
        ValueError: either part would have fewer than three frames, or there are too few clips.

    Source: paper, Protocol: a contiguous end of the clip, or a whole clip, is held out.
    """
    total = recording.n_frames
    if split.held_out_clips is not None:
        clips = recording.segments
        if split.held_out_clips >= len(clips):
            raise ValueError(
                f"recording {recording.meta.get('source')}: {len(clips)} clip(s), of which "
                f"held_out_clips = {split.held_out_clips} leave none to train on; give more clips or hold "
                "out a fraction"
            )
        n_train, rule = clips[-split.held_out_clips][0], f"held_out_clips = {split.held_out_clips}"
    elif split.held_out_frames is not None:
        n_train, rule = total - split.held_out_frames, f"held_out_frames = {split.held_out_frames}"
    else:
        assert split.train_fraction is not None, "the configuration gives exactly one rule"
        # 0.29 * 100 is 28.999..., and the floor of that is not what anyone means.
        n_train = math.floor(split.train_fraction * total + 1e-9)
        rule = f"train_fraction = {split.train_fraction}"
    if n_train < LEAST_FRAMES or total - n_train < LEAST_FRAMES:
        raise ValueError(
            f"recording {recording.meta.get('source', '(unnamed)')}: frames {total} in number, split into "
            f"{n_train} and {total - n_train} by {rule}; each part needs {LEAST_FRAMES} or more; give a "
            "longer recording or another split"
        )
    return replace(recording, n_train=n_train)


def crossing_frames(segments: Sequence[tuple[int, int]], n_train: int) -> tuple[int, int, int]:
    """Start, first held-out frame and end of the clip that holds both training and held-out frames.

    Raises:
        ValueError: the held-out part begins with a clip of its own.
    """
    for start, stop in segments:
        if start < n_train < stop:
            return start, n_train, stop
    raise ValueError(
        "the held-out part begins with a new clip, so that no forecast can cross into it; hold out the end "
        "of a clip (recording.split.held_out_frames)"
    )
