"""A free swing in miniature: small pictures of a square that comes to rest, and a whole run over them."""

from pathlib import Path

import numpy as np
import torch
from omegaconf import OmegaConf

from lagsplat.chart.chart import Chart
from lagsplat.evaluate.config import ExtrapolationConfig
from lagsplat.io.recording.recording import Recording
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.stage1.fit import fit_autoencoder
from lagsplat.stage2.lagrangian import Lagrangian
from tests.unit.evaluate import tiny_run
from tests.unit.stage1.problems import small_config

DT_S, FREQUENCY_HZ, RATE_PER_S = 1 / 30, 2.0, 0.5
SIDE = 16
DEFAULTS = Path(__file__).parents[3] / "conf" / "extrapolation" / "default.yaml"


def settings(**changes: object) -> ExtrapolationConfig:
    schema = OmegaConf.structured(ExtrapolationConfig)
    short = {"horizon_s": 20.0, "shown_s": 4.0, "looks": 2, "look_periods": 4.0}
    short["guarantee"] = {"duration_s": 60.0, "starts": 4}
    return OmegaConf.to_object(OmegaConf.merge(schema, OmegaConf.load(DEFAULTS), short, changes))


def motion(frames: int, first: int = 0) -> np.ndarray:
    time_s = DT_S * np.arange(first, first + frames)
    return np.exp(-RATE_PER_S * time_s) * np.cos(2 * np.pi * FREQUENCY_HZ * time_s)


def pictures(angles: np.ndarray) -> np.ndarray:
    """Images (N,3,H,W) of the swing at these angles."""
    x = SIDE * (0.5 + 0.2 * angles)
    rows, columns = np.indices((SIDE, SIDE)) + 0.5
    ink = np.clip(3.0 - np.abs(columns[None] - x[:, None, None]), 0, 1)
    ink = ink * np.clip(SIDE / 4 - np.abs(rows - SIDE / 2), 0, 1)
    return (0.1 + 0.8 * np.stack([ink, 0.5 * ink, 1 - ink], axis=1)).astype(np.float32)


def recording(frames: int = 120, held_out: int = 40) -> Recording:
    images = np.moveaxis(pictures(motion(frames)), 1, 3)
    return Recording(
        frames=np.round(255 * images).astype(np.uint8),
        time_s=DT_S * np.arange(frames),
        inputs=np.zeros((frames, 0)),
        input_names=(),
        input_units=(),
        meta={"origin": "simulated", "source": "swing", "sha256": "0", "licence": "none"},
        n_train=frames - held_out,
    )


def lagrangian() -> Lagrangian:
    """The true law; an affine chart of the swing obeys it too, about another rest."""
    return tiny_run.lagrangian(1, n_inputs=0, frequency_hz=FREQUENCY_HZ)


def run(film: Recording) -> tuple[Autoencoder, Chart, Lagrangian]:
    """A briefly trained autoencoder, its chart, and the true law resting where the swing does."""
    config = small_config(steps=250, n_gaussians=60)
    model, _ = fit_autoencoder(film.frames[: film.n_train], config, seed=0)
    chart = tiny_run.chart(model, film)
    law = lagrangian()
    still = torch.from_numpy(pictures(np.zeros(1)))
    with torch.no_grad():
        rest = chart.to_whitened(model.encode(still).double().numpy())
        law.rest.copy_(torch.from_numpy(rest[0]))
    return model, chart, law
