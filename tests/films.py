"""Films made for the purpose: a dark ball that swings before a wall, with faults of known size."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np

RATE = 25.0
PERIOD_S = 1.373
MARGIN = 16  # pixels of wall beyond the picture, so that a camera can move


def swing(
    *,
    seconds: float = 6.0,
    shape: tuple[int, int] = (120, 160),
    camera: Callable[[float], tuple[float, float]] = lambda t: (0.0, 0.0),
    gain: Callable[[float], float] = lambda t: 1.0,
    phase: Callable[[float], float] = lambda t: 0.0,
    hand_until_s: float = 0.0,
    rate: float = RATE,
    period_s: float = PERIOD_S,
    amplitude: float = 0.5,
) -> tuple[np.ndarray, np.ndarray]:
    """Frames (T, H, W, 3), RGB, and their times [s].

    ``camera`` is how far the scene has moved in the picture (x, y) [pixel] at time t, ``gain`` the exposure,
    ``phase`` is added to that of the swing of ``amplitude`` [rad], and a hand covers a corner until
    ``hand_until_s``.
    """
    rng = np.random.default_rng(3)
    rows, columns = shape
    wall = cv2.GaussianBlur(rng.normal(size=(rows + 2 * MARGIN, columns + 2 * MARGIN)), (0, 0), 1.5)
    wall = (130.0 + 25.0 * wall / wall.std()).astype(np.float32)
    time_s = np.arange(round(seconds * rate)) / rate
    frames = []
    for t in time_s:
        scene = wall.copy()
        if t < hand_until_s:
            cv2.rectangle(scene, (MARGIN + 4, MARGIN + rows - 30), (MARGIN + 30, MARGIN + rows), 230.0, -1)
        angle = amplitude * np.exp(-t / 20.0) * np.sin(2.0 * np.pi * t / period_s + phase(t))
        ball = np.array([columns / 2, 0.1 * rows]) + 0.6 * rows * np.array([np.sin(angle), np.cos(angle)])
        at = np.round(16 * (ball + MARGIN)).astype(int)
        cv2.circle(scene, tuple(int(x) for x in at), 16 * max(2, rows // 12), 20.0, -1, cv2.LINE_AA, 4)
        x, y = camera(float(t))
        shift = np.array([[1.0, 0.0, x], [0.0, 1.0, y]])
        moved = cv2.warpAffine(scene, shift, scene.shape[::-1], flags=cv2.INTER_CUBIC)
        seen = moved[MARGIN : MARGIN + rows, MARGIN : MARGIN + columns] * gain(float(t))
        seen = seen + rng.normal(scale=1.0, size=seen.shape)
        frames.append(np.clip(seen, 0, 255).astype(np.uint8)[..., None].repeat(3, axis=-1))
    return np.stack(frames), time_s


def write_film(path: Path, frames: np.ndarray, *, codec: str, rate: float = RATE) -> Path:
    """Keep RGB ``frames`` as a film; ``codec`` is ``FFV1`` (lossless), ``mp4v``, ..."""
    rows, columns = frames.shape[1:3]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), rate, (columns, rows))
    for frame in frames:
        writer.write(frame[..., ::-1])
    writer.release()
    return path


def index_first(content: bytes) -> bytes:
    """An MP4 with its index (``moov``) before the pictures, as films for the web have it."""
    boxes, position = {}, 0
    while position < len(content):
        size = int.from_bytes(content[position : position + 4], "big")
        boxes[content[position + 4 : position + 8]] = content[position : position + size]
        position += size
    index = bytearray(boxes.pop(b"moov"))
    table = index.index(b"stco")
    for entry in range(int.from_bytes(index[table + 8 : table + 12], "big")):
        at = table + 12 + 4 * entry
        place = int.from_bytes(index[at : at + 4], "big") + len(index)
        index[at : at + 4] = place.to_bytes(4, "big")
    first = boxes.pop(b"ftyp")
    return first + bytes(index) + b"".join(boxes.values())


def tag_rotation(path: Path, degrees: int) -> None:
    """Write a clockwise rotation of 90, 180 or 270 ``degrees`` into the track header of an MP4.

    The matrix is (a, b, u; c, d, v; x, y, w) in fixed point, 36 bytes (ISO/IEC 14496-12, section 8.3.2).
    """
    cosine, sine = {90: (0, 1), 180: (-1, 0), 270: (0, -1)}[degrees]
    numbers = [cosine << 16, sine << 16, 0, -sine << 16, cosine << 16, 0, 0, 0, 1 << 30]
    content = bytearray(path.read_bytes())
    # version and flags, two times, track, reserved, duration, two reserved, layer, group, volume, reserved
    at = content.index(b"tkhd") + 4 + 4 + 20 + 16
    content[at : at + 36] = b"".join(number.to_bytes(4, "big", signed=True) for number in numbers)
    path.write_bytes(bytes(content))
