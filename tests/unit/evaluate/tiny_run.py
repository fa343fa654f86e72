"""A whole run in miniature, from real parts that nobody trained: it checks plumbing, not quality."""

from pathlib import Path

import numpy as np
import torch

from lagsplat.chart.chart import Chart, fit_chart, save_chart
from lagsplat.chart.config import ChartConfig
from lagsplat.io.recording.recording import Recording, save_recording
from lagsplat.matter.field import save_matter
from lagsplat.matter.film_registration import list_pixels
from lagsplat.stage1.autoencoder import Autoencoder, save_autoencoder
from lagsplat.stage2.config import FormConfig
from lagsplat.stage2.fit import save_dynamics
from lagsplat.stage2.lagrangian import Coefficients, Floors, Lagrangian
from tests.matter_fields import make_linear_matter

DT_S = 1 / 60
FREQUENCY_HZ, RATE_PER_S = 2.0, 0.5
TIME_UNIT_S = 0.1


def recording(frames: int = 600, *, tail: int = 200, side: int = 16) -> Recording:
    """A square that swings under a random push, then freely."""
    rng = np.random.default_rng(0)
    push = np.repeat(rng.uniform(size=frames // 10 + 1), 10)[:frames]
    push[frames - tail :] = 0.0
    omega, angle, velocity, angles = 2 * np.pi * FREQUENCY_HZ, 0.0, 0.0, []
    for force in push:
        velocity += DT_S * (omega**2 * (force - 0.5 * (force > 0) - angle) - 2 * RATE_PER_S * velocity)
        angle += DT_S * velocity
        angles.append(angle)
    x = side * (0.5 + 0.25 * np.array(angles) / np.abs(angles).max())
    rows, columns = np.indices((side, side)) + 0.5
    ink = np.clip(3.0 - np.abs(columns[None] - x[:, None, None]), 0, 1) * (np.abs(rows - side / 2) < side / 4)
    colours = np.stack([ink, 0.5 * ink, 1 - ink], axis=3)
    noisy = 255 * (0.1 + 0.8 * colours) + rng.normal(0.0, 1.5, size=colours.shape)
    return Recording(
        frames=np.round(noisy).astype(np.uint8),
        time_s=DT_S * np.arange(frames),
        inputs=push[:, None],
        input_names=("push",),
        input_units=("N",),
        meta={"origin": "simulated", "source": "swinging square", "sha256": "0", "licence": "none"},
        n_train=frames // 2,
    )


def autoencoder(d: int = 2, side: int = 16) -> Autoencoder:
    """Random weights; the Gaussians lie in the picture and move with the latent."""
    torch.manual_seed(1)
    model = Autoencoder(
        d=d,
        n_gaussians=30,
        kernel=12,
        channels=2,
        height=side,
        width=side,
        background="learned",
        backend="torch",
    )
    with torch.no_grad():
        model.gaussians.center.uniform_(2.0, side - 2.0)
        model.gaussians.coupling.normal_(0.0, 3.0)
        model.gaussians.color_logit.normal_()
        model.gaussians.shape_log_diagonal.fill_(0.5)
        model.encoder.apply(_louder)
    return model.eval()


def _louder(module: torch.nn.Module) -> None:
    if isinstance(module, torch.nn.Conv2d | torch.nn.Linear):
        module.weight.mul_(2.0)


def chart(model: Autoencoder, film: Recording) -> Chart:
    settings = ChartConfig(
        smoothing_frames=1.0,
        rest_frames=5,
        eigenvalue_floor=1e-9,
        visibility_frames=16,
        visibility_step=1e-2,
        refinement_steps=0,
        dimension_frames=200,
        dimension_neighbours=10,
    )
    return fit_chart(model, film, settings)


def lagrangian(d: int = 2, *, n_inputs: int = 1, frequency_hz: float = FREQUENCY_HZ) -> Lagrangian:
    """A linear oscillator of the given frequency and of the recording's decay, in every coordinate."""
    omega, rate = 2 * np.pi * frequency_hz * TIME_UNIT_S, RATE_PER_S * TIME_UNIT_S
    eye = torch.eye(d, dtype=torch.float64)
    start = Coefficients(
        mass=eye,
        damping=2 * rate * eye,
        stiffness=(omega**2 + rate**2) * eye,
        pressure_map=torch.zeros(n_inputs, d, dtype=torch.float64),
        rest=torch.zeros(d, dtype=torch.float64),
    )
    form = FormConfig(
        mass="constant",
        damping="constant",
        potential="quadratic",
        actuation="linear",
        rest="fixed",
        matrix_width=4,
        potential_width=4,
        actuation_width=4,
        diffeo_blocks=1,
        diffeo_width=4,
        diffeo_lipschitz=0.9,
        terms="networks",
        potential_degree=None,
        input_degree=1,
        matrix_degree=None,
        map_degree=None,
    )
    return Lagrangian(start, form=form, floors=Floors(1e-3, 1e-3, 1e-3), time_unit_s=TIME_UNIT_S, seed=0)


def save_run(out: Path) -> None:
    """Write such a run of one coordinate into a folder, with the matter that it can be pushed at."""
    film, model = recording(120, tail=40), autoencoder(1)
    save_recording(out / "recording.safetensors", film)
    save_autoencoder(out / "autoencoder.safetensors", model, {})
    save_chart(out / "chart.safetensors", chart(model, film), {})
    save_dynamics(out / "dynamics.safetensors", lagrangian(1), {"report": {}})
    pixels = list_pixels(16, 16)
    sideways = torch.tensor([4.0, 0.0]).expand(len(pixels), 2)[..., None]
    save_matter(out / "matter.safetensors", make_linear_matter(pixels, sideways), {})
