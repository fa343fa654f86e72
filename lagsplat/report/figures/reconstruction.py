"""Held-out sides: what their cameras saw, what is drawn, and the difference.

Recorded, rendered and error frames of the image model.
"""

import numpy as np
from matplotlib.figure import Figure

from lagsplat.evaluate.novel_views import draw_novel_view
from lagsplat.io.recording.recording import Recording
from lagsplat.report.common.style import PAGE_IN, new_figure, paper_style
from lagsplat.stage1.autoencoder import Autoencoder, decode_latents, encode_frames
from lagsplat.views.novel import NovelViews

N_COLUMNS = 6
"""Columns: cameras in turn, each at another instant."""


def draw_novel_views(
    autoencoder: Autoencoder, recording: Recording, views: NovelViews, *, title: str
) -> Figure:
    """Seen, rendered and absolute error of the held-out cameras at instants spread over the whole recording.

    Where none is held out, of those that training saw. The error is the mean over channels, on one scale.
    """
    cameras = np.flatnonzero(views.held_out) if views.held_out.any() else np.array(views.seen)
    instants = np.linspace(0, recording.n_frames - 1, N_COLUMNS).round().astype(int)
    chosen = [(int(cameras[i % len(cameras)]), int(instant)) for i, instant in enumerate(instants)]
    n_train = recording.split()[0].n_frames
    latents = encode_frames(autoencoder, np.asarray(recording.frames[instants]))
    seen = [np.asarray(views.images[instant, camera]) / 255.0 for camera, instant in chosen]
    drawn = [
        draw_novel_view(autoencoder, z[None], views.space.seen_by(views.cameras[camera]))[0].clip(0, 1)
        for z, (camera, _) in zip(latents, chosen, strict=True)
    ]
    error = [np.abs(a - b).mean(2) for a, b in zip(seen, drawn, strict=True)]
    limit = max(float(np.max(error)), 1e-6)
    with paper_style():
        cell = PAGE_IN / (N_COLUMNS + 0.6)
        figure = new_figure(PAGE_IN, 3 * cell * recording.height / recording.width + 0.6, title=title)
        axes = figure.subplots(3, N_COLUMNS, squeeze=False)
        for column, (camera, instant) in enumerate(chosen):
            axes[0, column].imshow(seen[column])
            axes[1, column].imshow(drawn[column])
            map_ = axes[2, column].imshow(error[column], cmap="magma", vmin=0.0, vmax=limit)
            part = "train" if instant < n_train else "held out"
            axes[0, column].set_title(f"{views.names[camera]}\nframe {instant} ({part})")
        for axis in axes.ravel():
            axis.set(xticks=[], yticks=[])
            axis.spines[:].set_visible(False)
        for row, label in enumerate(("seen", "rendered", "|error|")):
            axes[row, 0].set_ylabel(label)
        bar = figure.colorbar(map_, ax=axes[2, :].tolist(), fraction=0.03, pad=0.01)
        bar.set_label("colour, 0 to 1")
    return figure


QUANTILES = (0.0, 0.25, 0.5, 0.75, 0.95, 1.0)
MAX_CANDIDATES = 300


def draw_reconstruction(autoencoder: Autoencoder, recording: Recording, *, title: str) -> Figure:
    """Frames from the best to the worst reconstructed, their renders and absolute errors.

    Columns are the quantiles of the error over up to 300 evenly spaced frames of ``recording``, so that the
    worst is shown beside the typical. The error is the mean over channels, on one scale for all columns.
    """
    frames = np.unique(np.linspace(0, recording.n_frames - 1, MAX_CANDIDATES).round().astype(int))
    stored = np.asarray(recording.frames[frames])
    rendered = decode_latents(autoencoder, encode_frames(autoencoder, stored))
    real = stored.astype(np.float32) / np.float32(255)
    shown = np.clip(np.moveaxis(rendered, 1, 3), 0.0, 1.0)
    mse = np.mean((shown - real) ** 2, axis=(1, 2, 3))
    order = np.argsort(mse)
    picks = [order[round(quantile * (len(order) - 1))] for quantile in QUANTILES]
    error = np.abs(shown - real).mean(axis=3)
    limit = max(float(error[picks].max()), 1e-6)
    with paper_style():
        cell = PAGE_IN / (len(picks) + 0.6)
        aspect = recording.height / recording.width
        figure = new_figure(PAGE_IN, 3 * cell * aspect + 0.6, title=title)
        axes = figure.subplots(3, len(picks), squeeze=False)
        names = ("best", "25 %", "median", "75 %", "95 %", "worst")
        for column, (pick, name) in enumerate(zip(picks, names, strict=True)):
            axes[0, column].imshow(real[pick])
            axes[1, column].imshow(shown[pick])
            map_ = axes[2, column].imshow(error[pick], cmap="magma", vmin=0.0, vmax=limit)
            axes[0, column].set_title(f"{name}: frame {frames[pick]}")
            axes[2, column].set_xlabel(f"MSE {mse[pick]:.2e}")
        for axis in axes.ravel():
            axis.set(xticks=[], yticks=[])
            axis.spines[:].set_visible(False)
        for row, label in enumerate(("recorded", "rendered", "|error|")):
            axes[row, 0].set_ylabel(label)
        bar = figure.colorbar(map_, ax=axes[2, :].tolist(), fraction=0.03, pad=0.01)
        bar.set_label("colour, 0 to 1")
    return figure
