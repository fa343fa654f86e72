"""Score the images of a spatial decoder for cameras that training did not use."""

from typing import Any

import numpy as np
import torch

from lagsplat.array_types import Frames
from lagsplat.evaluate.extrapolation.forecast import to_decibels
from lagsplat.io.recording.recording import Recording
from lagsplat.splat.projection import make_view
from lagsplat.stage1.autoencoder import CHUNK, Autoencoder, encode_frames, to_images
from lagsplat.views.camera import Camera
from lagsplat.views.novel import KNOWN, NovelViews, require_views


def score_novel_views(autoencoder: Autoencoder, recording: Recording, views: NovelViews) -> dict[str, Any]:
    """PSNR [dB] of rendered views at the encoded states, ready for JSON.

    ``held_out`` are the cameras that training did not use, ``seen`` the others and ``filmed`` the video's
    own; each over the training instants and over the rest. ``per_camera`` is over all instants. Pixels that
    a view does not know do not count.

    Raises:
        ValueError: the views are of another recording, or the Gaussians live in the image plane.
    """
    require_views(views, recording.frames)
    latents = encode_frames(autoencoder, recording.frames)
    train = np.arange(recording.n_frames) < recording.split()[0].n_frames
    rows = []
    for i, camera in enumerate(views.cameras):
        known = None if views.cover is None else views.cover[:, i] > 255 * KNOWN
        place = views.space.seen_by(camera)
        rows.append(view_errors(autoencoder, latents, place, views.images[:, i], known))
    reference = views.space.seen_by(views.space.reference)
    filmed = view_errors(autoencoder, latents, reference, recording.frames, None)
    errors = np.stack(rows)
    groups = {"held_out": errors[views.held_out], "seen": errors[~views.held_out], "filmed": filmed[None]}
    scores: dict[str, Any] = {
        name: {"train": _mean(values[:, train]), "rest": _mean(values[:, ~train]), "cameras": len(values)}
        for name, values in groups.items()
    }
    return scores | {"per_camera": dict(zip(views.names, map(_mean, errors), strict=True))}


@torch.no_grad()
def draw_novel_view(autoencoder: Autoencoder, latents: np.ndarray, camera: Camera) -> np.ndarray:
    """Images (T, H, W, 3) in [0, 1] at raw latents (T, d), by a camera in spatial coordinates."""
    z = torch.as_tensor(latents, dtype=torch.float32)
    drawn = [autoencoder.decode(part, view=make_view([camera])) for part in z.split(CHUNK)]
    return np.moveaxis(torch.cat(drawn).numpy(), 1, 3)


def view_errors(
    autoencoder: Autoencoder, latents: np.ndarray, camera: Camera, truth: Frames, known: np.ndarray | None
) -> np.ndarray:
    """Mean squared error (T,) of each rendered image over the pixels (T, H, W) ``known``, by default all."""
    wanted = np.moveaxis(to_images(np.asarray(truth)).numpy(), 1, 3)
    square = np.square(draw_novel_view(autoencoder, latents, camera) - wanted).mean(3)
    weight = np.ones_like(square) if known is None else known
    return (square * weight).sum((1, 2)) / np.maximum(weight.sum((1, 2)), 1)


def _mean(errors: np.ndarray) -> float | None:
    return float(to_decibels(errors.ravel().astype(np.float64)).mean()) if errors.size else None
