# mypy: ignore-errors
"""Draw a prepared cloud of Gaussians one frame at a time, as the viewer's loop does.

Whatever does not depend on the latent is computed once, as a ``table`` of rows over the Gaussians, padded to
a multiple of ``WIDTH``: origin x, y; Jacobian of x, of y; offset of the gate; the lower triangle of its
factor, row by row; ``ln(255 o)`` and ``o`` of the opacity; extents as in a slice. With ``w = factor z -
offset`` the largest sigma that is drawn is ``ln(255 o) - w.w / 2``, so skipping faded Gaussians needs no
exponential. `lagsplat.splat.gaussians` and `lagsplat.splat.cpu.rasterize` are the specification;
`tests/oracle/test_one_picture.py` compares with them.
"""

import numpy as np
import torch
from jaxtyping import Float64, UInt8

from lagsplat.splat.cpu import runs, tiles
from lagsplat.splat.cpu.forward import forward
from lagsplat.splat.cpu.rasterize import slices_of
from lagsplat.splat.cpu.simd import WIDTH, compiled, load, maximum, splat, square_root, store, to_bits
from lagsplat.splat.cpu.tiles import HALF, ZERO
from lagsplat.splat.gaussians import Gaussians


@compiled()
def slice_at(z, table, slices, color, height, width):
    """Spots (1, 6, M), slices (1, M, 5) and colours (1, M, 3) of the Gaussians inside the image."""
    count = table.shape[1]
    found = np.empty((6, count), np.float32)
    kept = np.empty(count, np.int32)
    number = 0
    for group in range(0, count, WIDTH):
        met = condition(found, z, table, group, height, width)
        for lane in range(WIDTH):
            if met >> lane & 1:
                kept[number] = group + lane
                number += 1
    spots = np.full((1, 6, (number + WIDTH - 1) // WIDTH * WIDTH), np.nan, np.float32)
    shapes = np.empty((1, number, slices.shape[1]), np.float32)
    colors = np.empty((1, number, 3), np.float32)
    for at in range(number):
        k = kept[at]
        for row in range(6):
            spots[0, row, at] = found[row, k]
        for column in range(slices.shape[1]):
            shapes[0, at, column] = slices[k, column]
        for channel in range(3):
            colors[0, at, channel] = color[k, channel]
    return spots, shapes, colors


@compiled()
def condition(found, z, table, k, height, width):
    """Fill in the ``WIDTH`` spots from ``k`` on; return as bits which are drawn. Spots with NaN are not."""
    count, d = table.shape[1], len(z)
    x = load(table, k)
    y = load(table, count + k)
    squares = splat(ZERO)
    factor = 2 + 3 * d
    for i in range(d):
        x = x + load(table, (2 + i) * count + k) * z[i]
        y = y + load(table, (2 + d + i) * count + k) * z[i]
        away = splat(ZERO) - load(table, (2 + 2 * d + i) * count + k)
        for j in range(i + 1):
            away = away + load(table, (factor + j) * count + k) * z[j]
        factor += i + 1
        squares = squares + away * away
    faded = squares * HALF
    cutoff = load(table, factor * count + k) - faded
    root = square_root(maximum(cutoff, splat(ZERO)))
    half_width = root * load(table, (factor + 2) * count + k)
    half_height = root * load(table, (factor + 3) * count + k)
    store(found, tiles.X * count + k, x)
    store(found, tiles.Y * count + k, y)
    store(found, tiles.OPACITY * count + k, runs.alpha_at(cutoff * runs.EIGHTH))
    store(found, tiles.CUTOFF * count + k, cutoff)
    store(found, tiles.HALF_WIDTH * count + k, half_width)
    store(found, tiles.HALF_HEIGHT * count + k, half_height)
    across = (x + half_width > ZERO) & (x - half_width < np.float32(width))
    down = (y + half_height > ZERO) & (y - half_height < np.float32(height))
    return to_bits((splat(ZERO) <= cutoff) & across & down)


@compiled()
def to_bytes(image):
    """Convert an image (3, H, W) in [0, 1] to uint8 (H, W, 3)."""
    _, height, width = image.shape
    picture = np.empty((height, width, 3), np.uint8)
    for row in range(height):
        for column in range(width):
            for channel in range(3):
                value = min(max(image[channel, row, column], np.float32(0.0)), np.float32(1.0))
                picture[row, column, channel] = np.uint8(value * np.float32(255.0) + HALF)
    return picture


class FrameRasterizer:
    """Draws the Gaussians of a decoder at ``height`` x ``width`` px on the CPU.

    ``stretch`` is the number of these pixels per pixel of the training resolution, along x and y.
    """

    @torch.no_grad()
    def __init__(
        self, gaussians: Gaussians, *, height: int, width: int, stretch: tuple[float, float]
    ) -> None:
        self.height, self.width = height, width
        x, y = stretch
        scale = torch.tensor([x, y])
        slices = slices_of(gaussians.covariance().cpu() * torch.tensor([x * x, x * y, y * y]))
        factor, jacobian = gaussians.precision_factor().cpu(), gaussians.jacobian().cpu()
        center, latent = gaussians.center.cpu(), gaussians.latent_center.cpu()[..., None]
        opacity = torch.sigmoid(gaussians.opacity_logit.cpu())
        row, column = torch.tril_indices(gaussians.d, gaussians.d)
        parts = [
            (center - (jacobian @ latent)[..., 0]) * scale,
            (jacobian * scale[:, None]).flatten(1),
            (factor @ latent)[..., 0],
            factor[:, row, column],
            (255.0 * opacity).log()[:, None],
            opacity[:, None],
            slices[:, [tiles.EXTENT_X, tiles.EXTENT_Y]],
        ]
        table = torch.cat(parts, 1).T.numpy()  # padded by Gaussians that are never drawn
        self.table = np.pad(table, ((0, 0), (0, -table.shape[1] % WIDTH)), constant_values=np.nan).copy()
        self.slices = slices.numpy()
        self.color = torch.sigmoid(gaussians.color_logit.cpu()).numpy()
        self.background = gaussians.background().cpu().numpy().copy()

    def draw(self, z: Float64[np.ndarray, " d"]) -> UInt8[np.ndarray, "H W 3"]:
        """Draw the raw latent ``z``; a latent that is not finite gives only the background."""
        scene = slice_at(z.astype(np.float32), self.table, self.slices, self.color, self.height, self.width)
        images, _ = forward(*scene, self.background, self.height, self.width)
        return to_bytes(images[0])
