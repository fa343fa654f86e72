"""Images that a run decodes from its latents, their error on a recording, and material points of the body."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.chart.chart import Chart
from lagsplat.diagnose.core.config import IMAGES
from lagsplat.evaluate.forecast import image_errors
from lagsplat.integer_lists import choose_evenly
from lagsplat.io.recording.recording import Recording
from lagsplat.stage1.autoencoder import Autoencoder, decode_latents


def read_frames(recording: Recording, at: np.ndarray) -> Float64[np.ndarray, "T H W 3"]:
    """Read the frames with numbers ``at``, colours in [0, 1]."""
    return recording.frames[at] / 255.0


def render_latents(
    autoencoder: Autoencoder, chart: Chart, q: Float64[np.ndarray, "T d"]
) -> Float64[np.ndarray, "T H W 3"]:
    """Decode images from whitened latents, colours in [0, 1]; a latent that is not finite is clipped."""
    images = decode_latents(autoencoder, chart.to_raw(np.nan_to_num(np.clip(q, -1e3, 1e3))))
    return np.clip(np.moveaxis(images, 1, 3).astype(np.float64), 0.0, 1.0)


def compute_decoding_errors(
    autoencoder: Autoencoder, chart: Chart, recording: Recording
) -> Float64[np.ndarray, " T"]:
    """Mean squared error of evenly spaced frames, each decoded from its own latents."""
    frames = recording.frames[choose_evenly(recording.n_frames, IMAGES.max_frames)]
    q = chart.encode(autoencoder, frames)
    return image_errors(render_latents(autoencoder, chart, q), frames / 255.0)


@dataclass(frozen=True)
class BodyPoints:
    """Points of the moving body."""

    rest: np.ndarray  # (P, 2) positions at the latents' mean [pixel, x to the right and y down]
    jacobian: np.ndarray  # (P, d, 2) pixels by which each whitened latent moves them

    def at(self, q: Float64[np.ndarray, "T d"]) -> Float64[np.ndarray, "T P 2"]:
        """Positions of the points at whitened latents [pixel]."""
        return self.rest + np.einsum("td,pdc->tpc", q, self.jacobian)


def find_body_points(autoencoder: Autoencoder, chart: Chart) -> BodyPoints:
    """Find material points that a force may act on: centres of clusters of Gaussians that move alike.

    Gaussians are weighted by their opacity along the training part, by their area and by how far they move.

    Raises:
        ValueError: no Gaussian moves.

    Source: paper, eqs. (schur-mean) and (latent_opacity).
    """
    gaussians = autoencoder.gaussians
    latents = chart.train.latents
    z = torch.as_tensor(chart.to_raw(latents[choose_evenly(len(latents), 64)]), dtype=torch.float32)
    with torch.no_grad():
        presence = (torch.sigmoid(gaussians.opacity_logit) * gaussians.gate(z)).mean(0).double().numpy()
        raw = gaussians.jacobian().double().numpy()
        centre = gaussians.center.double().numpy()
        latent_centre = gaussians.latent_center.double().numpy()
        area = gaussians.shape_log_diagonal[:, :2].sum(1).exp().double().numpy()
    rest = centre + np.einsum("kcj,kj->kc", raw, chart.mean - latent_centre)
    if gaussians.space == 3:
        rest, raw = _project_points(autoencoder, rest, raw)
    jacobian = np.einsum("kcj,ij->kic", raw, chart.unwhiten)
    motion = np.sqrt((jacobian**2).sum(axis=(1, 2)))
    weight = presence * area * motion
    inside = np.all((rest > 0.0) & (rest < [autoencoder.width, autoencoder.height]), axis=1)
    weight = np.where(inside, weight, 0.0)
    # equal weights stay equal whatever the order in which threads sum, so that clusters begin alike
    weight = np.round(weight / max(float(weight.max()), np.finfo(float).tiny), 6)
    order = np.argsort(-weight, kind="stable")
    enough = 1 + int(np.searchsorted(np.cumsum(weight[order]), IMAGES.body_share * weight.sum()))
    kept = order[:enough][weight[order[:enough]] > 0.0]
    if not len(kept):
        raise ValueError("no visible Gaussian of the run moves with its latents; check what stage 1 learned")
    features = np.concatenate([rest, jacobian.reshape(len(rest), -1)], axis=1)[kept]
    from sklearn.cluster import KMeans  # a second to import, which only this needs

    number = min(IMAGES.max_points, len(features))
    clusters = KMeans(number, n_init=1, random_state=0).fit(features, sample_weight=weight[kept])
    middle = clusters.cluster_centers_
    return BodyPoints(middle[:, :2].copy(), middle[:, 2:].reshape(number, -1, 2))


def _project_points(
    autoencoder: Autoencoder, places: np.ndarray, jacobian: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Project points of space (K, 3) and their Jacobians (K, 3, d) into the recorded image."""
    view = autoencoder.filmed_view(autoencoder.gaussians.center)
    focal, middle = (part[0].double().numpy() for part in (view.focal, view.middle))
    slope = places[:, :2] / places[:, 2:]
    moved = jacobian[:, :2] - slope[:, :, None] * jacobian[:, 2:]
    return focal * slope + middle, focal[:, None] * moved / places[:, 2:, None]


def find_nearest_frames(recording: Recording, time_s: np.ndarray) -> np.ndarray:
    """Numbers of the frames nearest to ``time_s`` (n,) [s] on the recording's clock."""
    return np.searchsorted(0.5 * (recording.time_s[1:] + recording.time_s[:-1]), time_s)
