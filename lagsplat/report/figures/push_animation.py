"""A moving picture: a film, the simulation fitted to it under a push, and the answer over time."""

import io
import os
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float64, UInt8
from PIL import Image

from lagsplat.forces.operating_point import OperatingPoint
from lagsplat.io.files.atomic import replace_atomically
from lagsplat.report.common.style import PREDICTED, draw_arrow, new_figure, paper_style
from lagsplat.report.figures.forces import FORCE_COLOUR

WIDTH_IN, DPI = 7.2, 100
ARROW_SHARE = 0.3  # length of the arrow over the smaller side of the image
BRUSH_SHARE = 0.05  # radius of what is grasped over the image's width
PUSH_SHARE = 0.5  # of the visited radius by which the force moves the state at rest
HOLD_S, DURATION_S = 1.2, 4.0
SUPERSAMPLING = 4  # pixels rendered in place of one of the recording, each way


@dataclass(frozen=True)
class PushView:
    """A push of a simulation beside the film that it was fitted to, frame by frame."""

    film: UInt8[np.ndarray, "N h w 3"]
    pushed: Float[np.ndarray, "N H W 3"]  # the simulation, in [0, 1]
    feet: Float64[np.ndarray, "n 2"]  # where the matter is that is pushed, while it is [px of the film]
    direction: Float64[np.ndarray, "2"]  # of the force, right and down
    moved_px: Float64[np.ndarray, " N"]  # how far that matter is from where it was
    dt_s: float  # time between two frames [s]


def compute_push_view(point: OperatingPoint, film: UInt8[np.ndarray, "T h w 3"]) -> PushView:
    """Push a run where its image moves most, along that motion, and let go.

    Raises:
        ValueError: nothing moves in the image.
    """
    at, along = point.find_lever()
    grasp, direction = point.grasp(at, radius=BRUSH_SHARE * point.width), np.array(along)
    n = min(len(film), round(DURATION_S / point.chart.dt_s) + 1)
    duration_s = (n - 1) * point.chart.dt_s
    states, _ = point.push(grasp, direction, share=PUSH_SHARE, hold_s=HOLD_S, duration_s=duration_s)
    feet = np.stack([grasp.place(q).numpy() for q in states])
    return PushView(
        film=film[:n],
        pushed=point.render_images(states, scale=SUPERSAMPLING),
        feet=feet[: round(HOLD_S / point.chart.dt_s)],
        direction=direction,
        moved_px=(feet - feet[0]) @ direction,
        dt_s=point.chart.dt_s,
    )


def save_push_animation(path: str | os.PathLike[str], view: PushView, *, title: str) -> None:
    """Draw every frame and write them as one GIF that repeats, whole or not at all."""
    drawn = (io.BytesIO(_draw_frame(view, k, title)) for k in range(len(view.pushed)))
    frames = [Image.open(file).convert("RGB") for file in drawn]
    colours = frames[len(frames) // 2].quantize(255)  # one palette for all, so that still parts stay still
    reduced = [frame.quantize(palette=colours, dither=Image.Dither.NONE) for frame in frames]
    with replace_atomically(path) as partial:
        duration_ms = 10 * round(100.0 * view.dt_s)  # GIF counts in hundredths of a second
        reduced[0].save(
            partial, format="GIF", save_all=True, append_images=reduced[1:], duration=duration_ms, loop=0
        )


@paper_style()
def _draw_frame(view: PushView, k: int, title: str) -> bytes:
    height, width = view.film.shape[1:3]
    figure = new_figure(WIDTH_IN, 0.42 * WIDTH_IN * height / width + 0.25, title=title)
    film, pushed, answer = figure.subplots(1, 3)
    acts = k < len(view.feet)
    for axis, image, name in (
        (film, view.film[k], "the film"),
        (
            pushed,
            np.clip(view.pushed[k], 0.0, 1.0),
            f"its simulation, {'pushed' if acts else 'let go'}",
        ),
    ):
        axis.imshow(image, extent=(0.0, width, height, 0.0), interpolation="bilinear")
        axis.set(xlim=(0.0, width), ylim=(height, 0.0), xticks=[], yticks=[])
        axis.set_title(name, loc="left")
    if acts:
        reach = ARROW_SHARE * min(height, width) * view.direction
        draw_arrow(pushed, view.feet[k], view.feet[k] + reach, FORCE_COLOUR, linewidth=2.0, rim=4.0)
    time_s = view.dt_s * np.arange(len(view.moved_px))
    answer.axvspan(0.0, view.dt_s * len(view.feet), color=FORCE_COLOUR, alpha=0.12, linewidth=0)
    answer.plot(time_s[: k + 1], view.moved_px[: k + 1], color=PREDICTED)
    most = 1.05 * float(np.abs(view.moved_px).max())
    answer.set(xlim=(0.0, time_s[-1]), ylim=(min(0.0, 1.05 * float(view.moved_px.min())), most))
    answer.set(xlabel="time (s)")
    answer.set_title("where it was pushed: way along the force (px)", loc="left")
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI)
    return buffer.getvalue()
