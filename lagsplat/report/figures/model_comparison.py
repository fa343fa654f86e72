"""Figures of images: models side by side, attention maps, reconstructions, novel views and their errors."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Float32
from matplotlib.figure import Figure

from lagsplat.baselines.model import Baseline
from lagsplat.baselines.networks import AttentionDecoder, compute_attention_centres
from lagsplat.evaluate.novel_views import draw_novel_view
from lagsplat.evaluate.protocol import EvaluationSubject, roll_out
from lagsplat.integer_lists import choose_evenly
from lagsplat.io.recording.recording import Recording
from lagsplat.report.common.formatting import format_number
from lagsplat.report.common.style import PAGE_IN, PREDICTED, add_colorbar, new_figure, paper_style
from lagsplat.stage1.autoencoder import Autoencoder, decode_latents, encode_frames
from lagsplat.views.novel import NovelViews

TIMES_S = (0.0, 0.25, 0.5, 1.0, 2.0, 5.0)
N_COLUMNS = 6  # columns of novel views: the cameras in turn, each at another instant
QUANTILES = {"best": 0.0, "25 %": 0.25, "median": 0.5, "75 %": 0.75, "95 %": 0.95, "worst": 1.0}
MAX_CANDIDATES = 300

FrameStack = Float32[np.ndarray, "n 3 H W"]


class AttentionMaps(NamedTuple):
    """The attention maps of one model at one frame."""

    name: str
    picture: Float32[np.ndarray, "3 H W"]
    maps: Float[np.ndarray, "G H W"]
    centres: Float[np.ndarray, "G 2"]  # `(row, column)` in pixels, counted from the centre of the first one


def choose_frames(subject: EvaluationSubject) -> np.ndarray:
    """Choose the frames `TIMES_S` after the first scored one of the longest clip, as far as the clip goes."""
    first, stop = subject.held.longest
    frames = first + np.round(np.array(TIMES_S) / subject.held.dt_s).astype(np.int64)
    return frames[frames < stop]


def predict_frames(subject: EvaluationSubject, frames: np.ndarray) -> FrameStack:
    """Predict frames with a model, from its own state at the first of them."""
    length = int(frames[-1] - frames[0]) + 1
    states = roll_out(subject.held, subject.integrate, frames[:1], length)[0]
    finite = np.nan_to_num(states[frames - frames[0]], posinf=0.0, neginf=0.0)
    return subject.render(finite).astype(np.float32)


@torch.no_grad()
def compute_attention(
    name: str, baseline: Baseline, picture: Float32[np.ndarray, "3 H W"]
) -> AttentionMaps | None:
    """Compute the attention maps of a model at an image; None where it has none."""
    decoder = baseline.decoder
    if not isinstance(decoder, AttentionDecoder):
        return None
    maps = decoder.maps(baseline.encoder(torch.from_numpy(picture[None]))[0])
    side = torch.tensor(decoder.size) - 1
    places = 0.5 * (compute_attention_centres(maps, decoder.places)[0] + 1.0) * side
    return AttentionMaps(name, picture, maps[0].unflatten(1, decoder.size).numpy(), places.numpy())


def draw_comparison(models: Mapping[str, EvaluationSubject], *, title: str) -> Figure:
    """Draw a row for the recording and each model, from the first scored frame of its longest clip on."""
    subject = next(iter(models.values()))
    frames = choose_frames(subject)
    rows = [("recorded", subject.pictures(frames))]
    rows += [(name, predict_frames(model, frames)) for name, model in models.items()]
    with paper_style():
        side, title = PAGE_IN / 8.0, f"Every model from the same start · {title}"
        figure = new_figure(side * len(frames) + 1.4, side * len(rows) + 0.6, title=title)
        axes = figure.subplots(len(rows), len(frames), squeeze=False)
        for row, (name, images) in zip(axes, rows, strict=True):
            for axis, image in zip(row, images, strict=True):
                axis.imshow(np.clip(np.moveaxis(image, 0, 2), 0.0, 1.0))
                axis.set(xticks=[], yticks=[])
            row[0].set_ylabel(name, rotation=0, ha="right", va="center")
        for axis, time_s in zip(axes[0], subject.held.dt_s * (frames - frames[0]), strict=True):
            axis.set_title(f"{time_s:.2g} s")
    return figure


def draw_attention(models: Sequence[AttentionMaps], *, title: str) -> Figure:
    """Draw a row for each model: the image, then the map of each node, its centre of mass and largest value.

    Each map has a scale of its own, from zero to that value.

    Raises:
        ValueError: no model has maps.
    """
    if not models:
        raise ValueError("nothing to draw: no baseline has attention maps; add osc_abcd or koopman_abcd")
    columns = 1 + max(len(model.maps) for model in models)
    key = "black: no attention, white: the largest of the map; cross: its centre of mass"
    with paper_style():
        width = min(PAGE_IN, max(0.9 * columns + 1.0, 4.4))
        side = min((width - 1.0) / columns, 1.0)
        figure = new_figure(width, (side + 0.35) * len(models) + 0.5, title=f"{title}\n{key}")
        axes = figure.subplots(len(models), columns, squeeze=False)
        for axis in axes.flat:
            axis.set(xticks=[], yticks=[])
            axis.set_axis_off()
        for line, model in zip(axes, models, strict=True):
            line[0].set_axis_on()
            line[0].imshow(np.moveaxis(model.picture, 0, 2))
            line[0].set_ylabel(f"{model.name}\n{len(model.maps)} nodes", rotation=0, ha="right", va="center")
            for index, (axis, attention) in enumerate(zip(line[1:], model.maps, strict=False)):
                axis.imshow(attention, cmap="gray", vmin=0.0, vmax=max(float(attention.max()), 1e-12))
                row, column = model.centres[index]
                axis.plot(column, row, "+", color="white", markersize=6, markeredgewidth=2.0)
                axis.plot(column, row, "+", color=PREDICTED, markersize=5, markeredgewidth=1.0)
                axis.set_title(f"node {index + 1}\nto {format_number(float(attention.max()))}", pad=2)
    return figure


@paper_style()
def draw_reconstruction(autoencoder: Autoencoder, recording: Recording, *, title: str) -> Figure:
    """Draw frames from the best to the worst reconstructed, their renders and absolute errors.

    Columns are the quantiles of the error over up to 300 evenly spaced frames of ``recording``, so that the
    worst stands beside the typical. The error is the mean over channels.
    """
    frames = choose_evenly(recording.n_frames, MAX_CANDIDATES)
    stored = np.asarray(recording.frames[frames])
    images = decode_latents(autoencoder, encode_frames(autoencoder, stored))
    real = stored.astype(np.float32) / np.float32(255)
    rendered = np.clip(np.moveaxis(images, 1, 3), 0.0, 1.0)
    mse = np.mean((rendered - real) ** 2, axis=(1, 2, 3))
    order = np.argsort(mse)
    picks = [order[round(quantile * (len(order) - 1))] for quantile in QUANTILES.values()]
    figure, axes = _draw_comparison([real[i] for i in picks], [rendered[i] for i in picks], "recorded", title)
    for column, (pick, name) in enumerate(zip(picks, QUANTILES, strict=True)):
        axes[0, column].set_title(f"{name} (frame {frames[pick]})")
        axes[2, column].set_xlabel(f"MSE {format_number(mse[pick])}")
    return figure


@paper_style()
def draw_novel_views(
    autoencoder: Autoencoder, recording: Recording, views: NovelViews, *, title: str
) -> Figure:
    """Draw held-out cameras at instants spread over the recording: seen, rendered and absolute error.

    Where no camera is held out, those of the training are drawn. The error is the mean over channels.
    """
    cameras = np.flatnonzero(views.held_out) if views.held_out.any() else np.array(views.seen)
    instants = choose_evenly(recording.n_frames, N_COLUMNS)
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
    """Draw real images (H, W, 3), their renders and the error, on one scale, a column each."""
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
