"""The autoencoder: a small encoder, and Gaussians that a rasteriser draws."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float32
from torch import Tensor, nn

from lagsplat.array_types import Frames, Images, Latents, Series
from lagsplat.io.files.artifact import load_artifact, restore_module, save_artifact
from lagsplat.splat.gaussians import Gaussians, GaussianSlice
from lagsplat.splat.image_model import rasterize
from lagsplat.splat.projection import View, project
from lagsplat.stage1.encoder import Encoder

KIND, SCHEMA = "autoencoder", 1
CHUNK = 256  # images encoded or drawn at once: bounds memory, not results


class Autoencoder(nn.Module):
    """Encoder and decoder of one recording; draws at the training resolution by default.

    Args:
        d: Latent dimension.
        n_gaussians: Number of Gaussians ``K``.
        kernel, channels: Side [px] and number of the encoder's filters.
        height, width: Training resolution [px].
        background: 'learned' or 'black'.
        lens: Focal lengths and principal point (x, y, x, y) [px] of the recording's camera for Gaussians in
            space (`lagsplat.views.camera`); None for Gaussians in the image plane.
        backend: Rasteriser, see `lagsplat.splat.image_model.rasterize`.

    Example:
        >>> import lagsplat
        >>> model = lagsplat.open_run("run").autoencoder
        >>> model.height, model.width
        (...)
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
        lens: Sequence[float] | None = None,
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
            "lens": None if lens is None else list(lens),
        }
        self.d, self.height, self.width, self.backend = d, height, width, backend
        self.lens = None if lens is None else list(lens)
        self.encoder = Encoder(d, kernel=kernel, channels=channels)
        space = 2 if lens is None else 3
        self.gaussians = Gaussians(n_gaussians, d, space=space, background=background)

    def encode(self, images: Images) -> Latents:
        """Encode a batch of images at the training resolution to raw latents."""
        return self.encoder(images)

    def decode(
        self, z: Latents, *, view: View | None = None, height: int | None = None, width: int | None = None
    ) -> Images:
        """Draw raw latents as images in [0, 1]; other arguments as in `draw`.

        Any resolution is possible, because no Gaussian is tied to a pixel.
        """
        return self.draw(self.gaussians.condition(z), view=view, height=height, width=width)

    def draw(
        self,
        scene: GaussianSlice,
        *,
        view: View | None = None,
        height: int | None = None,
        width: int | None = None,
    ) -> Images:
        """Draw slices as images in [0, 1], or whatever replaces their colours.

        Args:
            scene: The Gaussians at each latent.
            view: Cameras of the training resolution, one per image, for Gaussians in space. None takes the
                recording's own.
            height, width: Size of the images [px]. None takes the training resolution.

        Raises:
            ValueError: a view of Gaussians in the image plane.
        """
        height, width = height or self.height, width or self.width
        across, down = width / self.width, height / self.height
        if self.gaussians.space == 3:
            view = (self.filmed_view(scene.means) if view is None else view).resized(across, down)
            scene = project(scene, view, height=height, width=width)
        elif view is not None:
            raise ValueError(
                "these Gaussians live in the picture and have no other side; train with novel views, for "
                "instance views=simulated"
            )
        elif (across, down) != (1, 1):
            scale = scene.means.new_tensor([across * across, across * down, down * down])
            scene = scene._replace(means=scene.means * scale[::2].sqrt(), covariance=scene.covariance * scale)
        return rasterize(*scene, height=height, width=width, backend=self.backend)

    def filmed_view(self, like: Tensor) -> View:
        """The recording's own camera, which defines the coordinates of space."""
        assert self.lens is not None, "only Gaussians of space are seen by cameras"
        lens = like.new_tensor(self.lens)[None]
        return View(torch.eye(3).to(like)[None], like.new_zeros(1, 3), lens[:, :2], lens[:, 2:])


def to_images(frames: Frames | Tensor, device: torch.device | str = "cpu") -> Images:
    """Convert a batch of stored frames to torch images in [0, 1]."""
    batch = torch.from_numpy(np.array(frames)) if isinstance(frames, np.ndarray) else frames
    return batch.to(device).permute(0, 3, 1, 2).float().div_(255).contiguous()


@torch.no_grad()
def encode_frames(autoencoder: Autoencoder, frames: Frames) -> Series:
    """Encode stored frames to raw latents."""
    device = next(autoencoder.parameters()).device
    chunks = (frames[first : first + CHUNK] for first in range(0, len(frames), CHUNK))
    encoded = [autoencoder.encode(to_images(np.asarray(chunk), device)).double().cpu() for chunk in chunks]
    return torch.cat(encoded).numpy() if encoded else np.zeros((0, autoencoder.d))


def decode_chunks(
    autoencoder: Autoencoder, z: Series, *, height: int | None = None, width: int | None = None
) -> Iterator[Float32[np.ndarray, "chunk 3 H W"]]:
    """Draw raw latents in chunks of bounded size."""
    device = next(autoencoder.parameters()).device
    for first in range(0, len(z), CHUNK):
        chunk = torch.as_tensor(z[first : first + CHUNK], dtype=torch.float32, device=device)
        with torch.no_grad():
            images = autoencoder.decode(chunk, height=height, width=width)
        yield images.cpu().numpy()


def decode_latents(
    autoencoder: Autoencoder, z: Series, *, height: int | None = None, width: int | None = None
) -> Float32[np.ndarray, "T 3 H W"]:
    """Draw all raw latents at once; arguments as `decode_chunks`, which suits long series."""
    none = np.zeros((0, 3, height or autoencoder.height, width or autoencoder.width), np.float32)
    return np.concatenate([none, *decode_chunks(autoencoder, z, height=height, width=width)])


def save_autoencoder(path: Path, autoencoder: Autoencoder, header: Mapping[str, Any]) -> None:
    """Write the weights and the arguments that rebuild the module."""
    header = {"kind": KIND, "schema": SCHEMA, **header, "architecture": autoencoder.architecture}
    save_artifact(path, {name: value.cpu() for name, value in autoencoder.state_dict().items()}, header)


def load_autoencoder(path: Path, *, backend: str = "auto") -> tuple[Autoencoder, dict[str, Any]]:
    """Read an autoencoder and its header; ``backend`` chooses the rasteriser, which is not stored."""
    tensors, header = load_artifact(path, kind=KIND, schema=SCHEMA)
    autoencoder = Autoencoder(**header["architecture"], backend=backend)
    return restore_module(autoencoder, tensors, path), header
