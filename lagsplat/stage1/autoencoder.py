"""The autoencoder: a small encoder and a cloud of Gaussians that a rasteriser draws."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float32, Float64
from torch import Tensor, nn

from lagsplat.io.artefact import load_artefact, save_artefact
from lagsplat.shapes import Frames, Images, Latents
from lagsplat.splat.backend import rasterizer
from lagsplat.splat.gaussians import Gaussians
from lagsplat.stage1.encoder import Encoder

KIND, SCHEMA = "autoencoder", 1
CHUNK = 256  # images encoded or drawn at once: bounds memory, not results


class Autoencoder(nn.Module):
    """Encoder and decoder of one recording; it draws at its training resolution unless told otherwise.

    Args:
        d: Latent dimension.
        n_gaussians: Number of Gaussians ``K``.
        kernel, channels: Side [px] and number of the encoder's filters.
        height, width: Training resolution [px].
        background: 'learned' or 'black'.
        backend: Rasteriser, see `lagsplat.splat.backend.rasterizer`.
    """

    def __init__(
        self,
        *,
        d: int,
        n_gaussians: int,
        kernel: int,
        channels: int,
        height: int,
        width: int,
        background: str,
        backend: str = "auto",
    ) -> None:
        super().__init__()
        self.architecture = {
            "d": d,
            "n_gaussians": n_gaussians,
            "kernel": kernel,
            "channels": channels,
            "height": height,
            "width": width,
            "background": background,
        }
        self.d, self.height, self.width, self.backend = d, height, width, backend
        self.encoder = Encoder(d, kernel=kernel, channels=channels)
        self.gaussians = Gaussians(n_gaussians, d, background=background)

    def encode(self, images: Images) -> Latents:
        """Raw latents of a batch of images at the training resolution."""
        return self.encoder(images)

    def decode(self, z: Latents, *, height: int | None = None, width: int | None = None) -> Images:
        """Images drawn at the latents, in [0, 1]; at any resolution, since no Gaussian is tied to a pixel."""
        height, width = height or self.height, width or self.width
        means, covariance, opacity, color, background = self.gaussians.condition(z)
        if (height, width) != (self.height, self.width):
            x, y = width / self.width, height / self.height
            means = means * means.new_tensor([x, y])
            covariance = covariance * covariance.new_tensor([x * x, x * y, y * y])
        draw = rasterizer(self.backend, z.device)
        return draw(means, covariance, opacity, color, background, height=height, width=width)


def to_images(frames: Frames | Tensor, device: torch.device | str = "cpu") -> Images:
    """A batch of stored frames as torch images in [0, 1]."""
    batch = torch.from_numpy(np.array(frames)) if isinstance(frames, np.ndarray) else frames
    return batch.to(device).permute(0, 3, 1, 2).float().div_(255).contiguous()


@torch.no_grad()
def encode_frames(autoencoder: Autoencoder, frames: Frames) -> Float64[np.ndarray, "T d"]:
    """Raw latents of stored frames."""
    device = next(autoencoder.parameters()).device
    chunks = (frames[first : first + CHUNK] for first in range(0, len(frames), CHUNK))
    encoded = [autoencoder.encode(to_images(np.asarray(chunk), device)).double().cpu() for chunk in chunks]
    return torch.cat(encoded).numpy() if encoded else np.zeros((0, autoencoder.d))


def decode_chunks(
    autoencoder: Autoencoder,
    z: Float64[np.ndarray, "T d"],
    *,
    height: int | None = None,
    width: int | None = None,
) -> Iterator[Float32[np.ndarray, "chunk 3 H W"]]:
    """Images drawn at raw latents, a bounded number at a time."""
    device = next(autoencoder.parameters()).device
    for first in range(0, len(z), CHUNK):
        chunk = torch.as_tensor(z[first : first + CHUNK], dtype=torch.float32, device=device)
        with torch.no_grad():
            images = autoencoder.decode(chunk, height=height, width=width)
        yield images.cpu().numpy()


def decode_latents(
    autoencoder: Autoencoder,
    z: Float64[np.ndarray, "T d"],
    *,
    height: int | None = None,
    width: int | None = None,
) -> Float32[np.ndarray, "T 3 H W"]:
    """Images drawn at raw latents, all at once; see `decode_chunks` for long series."""
    shape = (0, 3, height or autoencoder.height, width or autoencoder.width)
    return np.concatenate(
        [np.zeros(shape, np.float32), *decode_chunks(autoencoder, z, height=height, width=width)]
    )


def save_autoencoder(path: Path, autoencoder: Autoencoder, header: Mapping[str, Any]) -> None:
    """Write the weights and what is needed to build the same module again."""
    header = {"kind": KIND, "schema": SCHEMA, **header, "architecture": autoencoder.architecture}
    save_artefact(path, {name: value.cpu() for name, value in autoencoder.state_dict().items()}, header)


def load_autoencoder(path: Path, *, backend: str = "auto") -> tuple[Autoencoder, dict[str, Any]]:
    """Read an autoencoder and its header; the rasteriser is no part of the weights, and chosen here."""
    tensors, header = load_artefact(path, kind=KIND, schema=SCHEMA)
    autoencoder = Autoencoder(**header["architecture"], backend=backend)
    autoencoder.load_state_dict({name: torch.as_tensor(value) for name, value in tensors.items()})
    return autoencoder.eval(), header
