"""A session on disk: an MCAP file with everything, a small film and an animation to show."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8

from lagsplat.io.mcap.write import ImageTopic, SessionLog, read_session, save_session
from lagsplat.io.video.read import save_gif, save_mp4
from lagsplat.viewer.rendering.renderer import FrameRenderer
from lagsplat.viewer.simulation.history import SessionHistory

FILM_HZ, GIF_HZ = 30.0, 15.0
GIF_S = 12.0
ARROW = (255, 122, 26)
SHARP = 4  # OpenCV's fraction bits of a place, so that an arrow glides


def history_to_log(taped: SessionHistory, meta: dict[str, Any], *, middle: tuple[float, ...]) -> SessionLog:
    """A tape as columns without gaps; where nothing is held the place is the ``middle``."""
    held = np.isfinite(taped.place).all(1)
    columns = {
        "q": taped.q, "v": taped.v, "u": taped.u, "load": taped.load, "force": taped.force,
        "place": np.where(held[:, None], taped.place, middle), "edits": taped.edits, "energy": taped.energy,
        "clip": taped.clip[:, None].astype(np.float64),
    }  # fmt: skip
    return SessionLog(taped.dt_s, columns, meta)


def log_to_history(log: SessionLog) -> SessionHistory:
    """The tape of a log, to be replayed."""
    columns = dict(log.columns)
    held = np.any(columns["force"] != 0.0, axis=1)
    columns["place"] = np.where(held[:, None], columns["place"], np.nan)
    return SessionHistory(log.dt_s, columns.pop("clip")[:, 0].astype(np.int64), **columns)


def load_history(path: Path) -> SessionHistory:
    """What a session did, from its MCAP file.

    Raises:
        FileNotFoundError, ValueError: as `lagsplat.io.mcap.write.read_session`.
    """
    return log_to_history(read_session(path))


def export_session(
    stem: Path,
    taped: SessionHistory,
    easel: FrameRenderer,
    meta: dict[str, Any],
    *,
    gain: float,
    small: FrameRenderer,
) -> tuple[Path, ...]:
    """Write ``stem.mcap`` with pictures by ``small``, ``stem.mp4`` and ``stem.gif`` with the arrow drawn in.

    ``gain`` is the force that is drawn as one pixel.

    Raises:
        FileExistsError: the MCAP file is there already.
    """
    pictures = ImageTopic("/camera/session", taped.time_s, (small.draw(q) for q in taped.q))
    mcap, film, animation = (stem.with_suffix(suffix) for suffix in (".mcap", ".mp4", ".gif"))
    save_session(mcap, history_to_log(taped, meta, middle=easel.middle), pictures=[pictures])
    save_mp4(film, _frames(taped, easel, gain=gain, rate_hz=FILM_HZ), rate_hz=FILM_HZ)
    last = _frames(taped, small, gain=gain, rate_hz=GIF_HZ, since_s=taped.time_s[-1] - GIF_S)
    save_gif(animation, last, rate_hz=GIF_HZ)
    return mcap, film, animation


def _frames(
    taped: SessionHistory, easel: FrameRenderer, *, gain: float, rate_hz: float, since_s: float = 0.0
) -> Iterator[UInt8[np.ndarray, "H W 3"]]:
    begin = max(0.0, since_s)
    for now in np.arange(begin, taped.time_s[-1] + 0.5 / rate_hz, 1.0 / rate_hz):
        row = min(len(taped) - 1, round(now / taped.dt_s))
        picture = easel.draw(taped.q[row])
        if np.isfinite(taped.place[row]).all() and taped.force[row].any():
            picture = pointed(picture, easel, taped.place[row], taped.force[row] / gain)
        yield picture


def pointed(
    picture: UInt8[np.ndarray, "H W 3"], easel: FrameRenderer, place: np.ndarray, drag: np.ndarray
) -> UInt8[np.ndarray, "H W 3"]:
    """The picture with an arrow from ``place`` along ``drag`` [px of the training resolution, or at the
    pivot]."""
    drawn = picture.copy(order="C")
    foot, tip = np.round(2**SHARP * easel.pixels(np.stack([place, place + drag]))).astype(int)
    thick = max(1, round(max(picture.shape) / 110))
    for color, width in (((0, 0, 0), thick + 2), (ARROW, thick)):
        cv2.arrowedLine(
            drawn, foot.tolist(), tip.tolist(), color, width, cv2.LINE_AA, shift=SHARP, tipLength=0.25
        )
    return drawn
