"""Training data of stage 1: recorded frames, inputs and, in space, novel views of the same instants."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.array_types import Frames, Images, Latents, Series
from lagsplat.splat.projection import View, compute_depths, make_view
from lagsplat.stage1.autoencoder import Autoencoder, to_images
from lagsplat.stage1.linear_response import InputHistory, LinearResponse
from lagsplat.stage1.objective import ExpectedLatents, NovelViewTargets
from lagsplat.views.config import SupervisionConfig
from lagsplat.views.novel import NovelViews, require_views


class TrainingFrames:
    """Training frames on a device, with raw latents and novel views of the same instants if given.

    ``history`` holds the inputs of the frames; None tells nothing.
    ``supervision`` is how the views enter the loss.

    Raises:
        ValueError: views without their settings, or of other frames, see `require_views`.
    """

    def __init__(
        self,
        frames: Frames,
        *,
        device: str = "cpu",
        latents: Series | None = None,
        novel: NovelViews | None = None,
        supervision: SupervisionConfig | None = None,
        history: InputHistory | None = None,
    ) -> None:
        if (novel is None) != (supervision is None):
            raise ValueError("novel views and the settings of what they teach come together or not at all")
        if novel is not None:
            require_views(novel, frames)
        self.stored = torch.from_numpy(np.array(frames)).to(device)  # a copy: the file is mapped read-only
        self.device, self.novel, self.supervision = device, novel, supervision
        self.history = history
        self.latents: Latents | None = None
        if latents is not None:
            self.latents = torch.as_tensor(latents, dtype=torch.float32, device=device)
        self.cameras = () if novel is None else tuple(novel.space.seen_by(each) for each in novel.cameras)

    def __len__(self) -> int:
        return len(self.stored)

    def sample(self, size: int, *, seed: int) -> np.ndarray:
        """Indices of at most ``size`` random frames, in the order of time."""
        return np.sort(np.random.default_rng(seed).permutation(len(self))[:size])

    def images(self, picked: np.ndarray) -> Images:
        """Recorded images at these indices."""
        return to_images(self.stored[torch.as_tensor(picked, device=self.device)], self.device)

    def known(self, picked: np.ndarray) -> Latents | None:
        """Given latents at these indices, or None."""
        return None if self.latents is None else self.latents[torch.as_tensor(picked, device=self.device)]

    def expect(self, picked: np.ndarray, response: LinearResponse | None) -> ExpectedLatents | None:
        """Latents at these indices by the response to the inputs, or None."""
        if self.history is None or response is None:
            return None
        parts = (response.predict(self.history.before(picked)), response.variance)
        return ExpectedLatents(
            *(torch.as_tensor(part, dtype=torch.float32).to(self.device) for part in parts)
        )

    def latents_of(self, autoencoder: Autoencoder, picked: np.ndarray) -> Latents:
        """Latents at these indices, given or encoded."""
        known = self.known(picked)
        return autoencoder.encode(self.images(picked)) if known is None else known

    def sides(self, picked: np.ndarray, rng: np.random.Generator) -> NovelViewTargets | None:
        """Novel views of these instants, each by a random training camera; None if there are none."""
        if self.novel is None or self.supervision is None:
            return None
        chosen = rng.choice(self.novel.seen, len(picked))
        return NovelViewTargets(*self._take(self.novel, picked, chosen), self.supervision.weight)

    def shots(
        self, autoencoder: Autoencoder, picked: np.ndarray, rng: np.random.Generator
    ) -> tuple[Images, Latents, View | None]:
        """Images, raw latents and cameras of these instants; None is the recording's own camera for all.

        If there are novel views, every other recorded image is replaced by one.
        """
        images, latents = self.images(picked), self.latents_of(autoencoder, picked)
        if self.novel is None or len(picked) < 2:
            return images, latents, None
        aside = slice(1, None, 2)
        chosen = rng.choice(self.novel.seen, len(picked[aside]))
        taken, cover, other_view = self._take(self.novel, picked[aside], chosen)
        film = autoencoder.filmed_view(latents)
        view = View(*(part.repeat(len(picked), *[1] * (part.ndim - 1)) for part in film))
        for part, other in zip(view, other_view, strict=True):
            part[aside] = other
        if cover is not None:  # where the view is unknown, the target is the drawn image
            taken = torch.lerp(autoencoder.decode(latents[aside], view=other_view), taken, cover)
        images[aside] = taken
        return images, latents, view

    def _take(
        self, novel: NovelViews, picked: np.ndarray, chosen: np.ndarray
    ) -> tuple[Images, Tensor | None, View]:
        """Novel views of instants by the chosen cameras, what is known of each, and the cameras."""
        images = to_images(np.stack([novel.images[i, j] for i, j in zip(picked, chosen, strict=True)]))
        view = View(*(part.to(self.device) for part in make_view([self.cameras[i] for i in chosen])))
        if novel.cover is None:
            return images.to(self.device), None, view
        cover = np.stack([novel.cover[i, j] for i, j in zip(picked, chosen, strict=True)])
        return images.to(self.device), torch.from_numpy(cover)[:, None].to(self.device) / 255, view


FAINT = 1e-3  # cover below which a pixel shows the background, which has no depth


@torch.no_grad()
def render_depth(autoencoder: Autoencoder, z: Latents, view: View) -> Float[Tensor, "B H W"]:
    """Mean depth of each pixel for each camera [unit of space]; empty pixels get the pivot's depth."""
    depth, cover = composite_depths(autoencoder, z, view)
    pivot = autoencoder.filmed_view(z).focal[0, 0]
    return torch.where(cover > FAINT, depth / cover.clamp_min(FAINT), pivot)


@torch.no_grad()
def composite_depths(
    autoencoder: Autoencoder, z: Latents, view: View
) -> tuple[Float[Tensor, "B H W"], Float[Tensor, "B H W"]]:
    """Depths of the Gaussians in each pixel, summed with the weights of its colours, and these weights' sum.

    Compositing is linear, so depths replace the colours.

    Args:
        autoencoder: with Gaussians in space.
        z: raw latents.
        view: a camera for each or for all.
    """
    scene = autoencoder.gaussians.condition(z)
    ahead = compute_depths(scene.means, view)
    depths = torch.stack([ahead, torch.ones_like(ahead), torch.zeros_like(ahead)], dim=2)
    scene = scene._replace(color=depths, background=torch.zeros_like(scene.background))
    drawn = autoencoder.draw(scene, view=view)
    return drawn[:, 0], drawn[:, 1]
