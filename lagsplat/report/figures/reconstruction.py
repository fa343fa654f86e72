"""Frames, their renders and the absolute errors: of the training camera and of novel views."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from lagsplat.evaluate.novel_views import draw_novel_view
from lagsplat.io.recording.recording import Recording
from lagsplat.report.common.style import PAGE_IN, add_colorbar, new_figure, paper_style
from lagsplat.stage1.autoencoder import Autoencoder, decode_latents, encode_frames
from lagsplat.views.novel import NovelViews

N_COLUMNS = 6
"""Columns of novel views: the cameras in turn, each at another instant."""
QUANTILES = (0.0, 0.25, 0.5, 0.75, 0.95, 1.0)
QUANTILE_TITLES = ("best", "25 %", "median", "75 %", "95 %", "worst")
MAX_CANDIDATES = 300


def draw_reconstruction(autoencoder: Autoencoder, recording: Recording, *, title: str) -> Figure:
    """Draw frames from the best to the worst reconstructed, their renders and absolute errors.

    Columns are the quantiles of the error over up to 300 evenly spaced frames of ``recording``, so that the
    worst stands beside the typical. The error is the mean over channels.
    """
    frames = np.unique(np.linspace(0, recording.n_frames - 1, MAX_CANDIDATES).round().astype(int))
    stored = np.asarray(recording.frames[frames])
    images = decode_latents(autoencoder, encode_frames(autoencoder, stored))
    real = stored.astype(np.float32) / np.float32(255)
    rendered = np.clip(np.moveaxis(images, 1, 3), 0.0, 1.0)
    mse = np.mean((rendered - real) ** 2, axis=(1, 2, 3))
    order = np.argsort(mse)
    picks = [order[round(quantile * (len(order) - 1))] for quantile in QUANTILES]
    figure, axes = _draw_comparison([real[i] for i in picks], [rendered[i] for i in picks], "recorded", title)
    for column, (pick, name) in enumerate(zip(picks, QUANTILE_TITLES, strict=True)):
        axes[0, column].set_title(f"{name}: frame {frames[pick]}")
        axes[2, column].set_xlabel(f"MSE {mse[pick]:.2e}")
    return figure


def draw_novel_views(
    autoencoder: Autoencoder, recording: Recording, views: NovelViews, *, title: str
) -> Figure:
    """Draw held-out cameras at instants spread over the recording: seen, rendered and absolute error.

    Where no camera is held out, those of the training are drawn. The error is the mean over channels.
    """
    cameras = np.flatnonzero(views.held_out) if views.held_out.any() else np.array(views.seen)
    instants = np.linspace(0, recording.n_frames - 1, N_COLUMNS).round().astype(int)
    chosen = [(int(cameras[i % len(cameras)]), int(instant)) for i, instant in enumerate(instants)]
    n_train = recording.split()[0].n_frames
    latents = encode_frames(autoencoder, np.asarray(recording.frames[instants]))
    seen = [np.asarray(views.images[instant, camera]) / 255.0 for camera, instant in chosen]
    rendered = [
        draw_novel_view(autoencoder, z[None], views.space.seen_by(views.cameras[camera]))[0].clip(0, 1)
        for z, (camera, _) in zip(latents, chosen, strict=True)
    ]
    figure, axes = _draw_comparison(seen, rendered, "seen", title)
    for column, (camera, instant) in enumerate(chosen):
        part = "train" if instant < n_train else "held out"
        axes[0, column].set_title(f"{views.names[camera]}\nframe {instant} ({part})")
    return figure


def _draw_comparison(
    real: Sequence[np.ndarray], rendered: Sequence[np.ndarray], label: str, title: str
) -> tuple[Figure, np.ndarray]:
    """Draw real images (H, W, 3), their renders and the error, on one scale, a column each.

    Args:
        real: the images.
        rendered: one render for each.
        label: of the row of real images.
        title: of the figure.
    """
    errors = [np.abs(image - render).mean(2) for image, render in zip(real, rendered, strict=True)]
    limit = max(float(np.max(errors)), 1e-6)
    height, width = real[0].shape[:2]
    with paper_style():
        cell = PAGE_IN / (len(real) + 0.6)
        figure = new_figure(PAGE_IN, 3 * cell * height / width + 0.6, title=title)
        axes = figure.subplots(3, len(real), squeeze=False)
        for column, error in enumerate(errors):
            axes[0, column].imshow(real[column])
            axes[1, column].imshow(rendered[column])
            error_map = axes[2, column].imshow(error, cmap="magma", vmin=0.0, vmax=limit)
        for axis in axes.ravel():
            axis.set(xticks=[], yticks=[])
            axis.spines[:].set_visible(False)
        for row, text in enumerate((label, "rendered", "|error|")):
            axes[row, 0].set_ylabel(text)
        add_colorbar(figure, error_map, axes[2, :].tolist(), "colour, 0 to 1", fraction=0.03)
    return figure, axes
