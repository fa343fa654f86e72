"""Films of bodies that are painted at known poses, over a background that stands still."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

Places = np.ndarray  # (..., 2), x to the right and y down [px]


@dataclass(frozen=True)
class Body:
    """A painted body: where material points go at a state, the inverse of that, and which points it has."""

    carry: Callable[[Places, np.ndarray], Places]
    fetch: Callable[[Places, np.ndarray], Places]
    covers: Callable[[Places], np.ndarray]
    texture: Callable[[Places], np.ndarray]


def make_texture(seed: int, *, wave_px: float = 9.0) -> Callable[[Places], np.ndarray]:
    """A smooth random colour of every place."""
    rng = np.random.default_rng(seed)
    waves = rng.normal(size=(3, 6, 2)) * 2 * np.pi / wave_px
    phases, mean = rng.uniform(0, 2 * np.pi, (3, 6)), rng.uniform(0.3, 0.7, 3)

    def color(x: Places) -> np.ndarray:
        angle = np.einsum("...i,cwi->...cw", x, waves) + phases
        return np.clip(mean + 0.12 * np.sin(angle).sum(-1), 0.0, 1.0)

    return color


def make_rigid_body(
    pose: Callable[[np.ndarray], tuple[np.ndarray, float]],
    center: Sequence[float],
    half: Sequence[float],
    seed: int,
) -> Body:
    """A rectangle that turns about its center and is shifted by what ``pose`` says of a state."""
    middle = np.array(center)

    def turn(x: Places, angle: float) -> Places:
        c, s = np.cos(angle), np.sin(angle)
        return x @ np.array([[c, s], [-s, c]])

    def carry(x: Places, q: np.ndarray) -> Places:
        shift, angle = pose(q)
        return middle + turn(x - middle, angle) + shift

    def fetch(x: Places, q: np.ndarray) -> Places:
        shift, angle = pose(q)
        return middle + turn(x - middle - shift, -angle)

    def covers(x: Places) -> np.ndarray:
        return (np.abs(x - middle) < np.array(half)).all(-1)

    return Body(carry, fetch, covers, make_texture(seed))


def make_bending_body(seed: int) -> Body:
    """A hanging strip that bends to the side with one latent, and stretches with the other."""
    top, length = 6.0, 30.0

    def shift(y: np.ndarray, q: np.ndarray) -> np.ndarray:
        return 5.0 * q[0] * ((y - top) / length) ** 2

    def carry(x: Places, q: np.ndarray) -> Places:
        y = top + (x[..., 1] - top) * (1.0 + 0.06 * q[1])
        return np.stack([x[..., 0] + shift(y, q), y], -1)

    def fetch(x: Places, q: np.ndarray) -> Places:
        y = top + (x[..., 1] - top) / (1.0 + 0.06 * q[1])
        return np.stack([x[..., 0] - shift(x[..., 1], q), y], -1)

    def covers(x: Places) -> np.ndarray:
        return (np.abs(x[..., 0] - 24.0) < 6.0) & (x[..., 1] > top) & (x[..., 1] < top + length)

    return Body(carry, fetch, covers, make_texture(seed, wave_px=8.0))


def film(
    bodies: Sequence[Body], states: np.ndarray, *, height: int, width: int, noise: float = 0.005
) -> np.ndarray:
    """Frames of the bodies at states, uint8; the last body is in front."""
    rng, fine = np.random.default_rng(0), 2
    columns, rows = ((np.arange(fine * n) + 0.5) / fine for n in (width, height))
    x = np.stack(np.meshgrid(columns, rows), -1)
    background = make_texture(99)(x)
    frames = []
    for q in states:
        picture = background
        for body in bodies:
            material = body.fetch(x, q)
            picture = np.where(body.covers(material)[..., None], body.texture(material), picture)
        mean = picture.reshape(height, fine, width, fine, 3).mean((1, 3))
        frames.append(np.clip(mean + noise * rng.standard_normal(mean.shape), 0.0, 1.0))
    return np.round(255 * np.stack(frames)).astype(np.uint8)
