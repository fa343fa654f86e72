"""Writes a session as MCAP with all its data, as MP4 and as GIF, and reads the MCAP file."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8

from lagsplat.io.robot_log.write import ImageTopic, SessionLog, read_session, save_session
from lagsplat.io.video.write import save_gif, save_mp4
from lagsplat.viewer.rendering.renderer import FrameRenderer
from lagsplat.viewer.simulation.history import SessionHistory

COLUMNS = ("q", "v", "u", "load", "force", "place", "edits", "energy")
VIDEO_HZ, GIF_HZ = 30.0, 15.0
GIF_S = 12.0  # length of the animation [s]: the end of the session
ARROW = (255, 122, 26)
FRACTION_BITS = 4  # of a position in OpenCV, so that an arrow moves smoothly


def load_history(path: Path) -> SessionHistory:
    """Read the history of a session, which can be replayed, from its MCAP file."""
    log = read_session(path)
    columns = dict(log.columns)
    grasped = np.any(columns["force"] != 0.0, axis=1)
    columns["place"] = np.where(grasped[:, None], columns["place"], np.nan)
    return SessionHistory(log.dt_s, columns.pop("clip")[:, 0].astype(np.int64), **columns)


def export_session(
    stem: Path,
    history: SessionHistory,
    renderer: FrameRenderer,
    meta: dict[str, Any],
    *,
    gain: float,
    small_renderer: FrameRenderer,
) -> tuple[Path, ...]:
    """Write a session as ``stem.mcap``, ``stem.mp4`` and ``stem.gif``; the videos show the force as an arrow.

    An arrow is as long as the force over ``gain`` [energy per px^2].

    Raises:
        FileExistsError: the MCAP file exists already.
    """
    # no NaN in the file: where nothing is grasped, the place is the centre
    grasped = np.isfinite(history.place).all(1)
    columns = {name: getattr(history, name) for name in COLUMNS}
    columns["place"] = np.where(grasped[:, None], history.place, renderer.center)
    columns["clip"] = history.clip[:, None].astype(np.float64)
    images = ImageTopic("/camera/session", history.time_s, (small_renderer.draw(q) for q in history.q))
    mcap, video, animation = (stem.with_suffix(suffix) for suffix in (".mcap", ".mp4", ".gif"))
    save_session(mcap, SessionLog(history.dt_s, columns, meta), pictures=[images])
    save_mp4(video, _frames(history, renderer, gain=gain, rate_hz=VIDEO_HZ), rate_hz=VIDEO_HZ)
    last = _frames(history, small_renderer, gain=gain, rate_hz=GIF_HZ, since_s=history.time_s[-1] - GIF_S)
    save_gif(animation, last, rate_hz=GIF_HZ)
    return mcap, video, animation


def _frames(
    history: SessionHistory, renderer: FrameRenderer, *, gain: float, rate_hz: float, since_s: float = 0.0
) -> Iterator[UInt8[np.ndarray, "H W 3"]]:
    begin = max(0.0, since_s)
    for now in np.arange(begin, history.time_s[-1] + 0.5 / rate_hz, 1.0 / rate_hz):
        row = min(len(history) - 1, round(now / history.dt_s))
        frame = renderer.draw(history.q[row])
        if np.isfinite(history.place[row]).all() and history.force[row].any():
            frame = draw_drag_arrow(frame, renderer, history.place[row], history.force[row] / gain)
        yield frame


def draw_drag_arrow(
    frame: UInt8[np.ndarray, "H W 3"], renderer: FrameRenderer, place: np.ndarray, drag: np.ndarray
) -> UInt8[np.ndarray, "H W 3"]:
    """Draw an arrow from ``place`` along ``drag`` [px of the training resolution, or at the pivot]."""
    drawn = frame.copy(order="C")
    ends = renderer.project_points(np.stack([place, place + drag]))
    foot, tip = np.round(2**FRACTION_BITS * ends).astype(int).tolist()
    thick = max(1, round(max(frame.shape) / 110))
    for color, width in (((0, 0, 0), thick + 2), (ARROW, thick)):
        cv2.arrowedLine(drawn, foot, tip, color, width, cv2.LINE_AA, shift=FRACTION_BITS, tipLength=0.25)
    return drawn
