"""A simulator that is a fitted run: its Lagrangian over whitened latents, and videos encoded into these."""

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch

from lagsplat.chart.chart import Chart
from lagsplat.diagnose.estimation.dataset import OperatingRegion
from lagsplat.diagnose.simulators.projection import FieldFunctions, ProjectedModel, project_fields
from lagsplat.diagnose.simulators.sources import make_video_trajectory
from lagsplat.io.recording.recording import Recording
from lagsplat.io.trajectory.trajectory import Trajectory
from lagsplat.stage1.autoencoder import Autoencoder, encode_frames
from lagsplat.stage2.fit import load_dynamics
from lagsplat.stage2.lagrangian import Lagrangian

BATCH_SIZE = 256  # points that the networks evaluate at once, which bounds their memory
"""States that a network evaluates at once, to bound the memory."""


def load_run_dynamics(folder: Path) -> Lagrangian:
    """Load the Lagrangian of the run in ``folder``.

    Raises:
        FileNotFoundError: it is neither there nor in the two folders above.
    """
    for candidate in (folder, *folder.resolve().parents[:2]):
        if (candidate / "dynamics.safetensors").is_file():
            return load_dynamics(candidate / "dynamics.safetensors")[0]
    raise FileNotFoundError(
        f"{folder}: no dynamics.safetensors there or up to two folders above; give the folder of a "
        "finished fit"
    )


def project_run(lagrangian: Lagrangian, region: OperatingRegion, *, what: str) -> ProjectedModel:
    """The model of a fitted Lagrangian over a region of whitened latents, with time in seconds.

    Raises:
        ValueError: the region has other numbers of latents or inputs.
    """
    if (lagrangian.d, lagrangian.n_inputs) != (region.d, region.n_u):
        raise ValueError(
            f"{what}: the run has {lagrangian.d} latent(s) and {lagrangian.n_inputs} input(s), but the "
            f"recording {region.d} and {region.n_u}; encode the recording with this run's own autoencoder"
        )
    return project_fields(make_run_fields(lagrangian, region), region, what=what)


def make_run_fields(lagrangian: Lagrangian, region: OperatingRegion) -> FieldFunctions:
    """Mass, forces and input map of a Lagrangian with time in seconds; energies keep the Lagrangian's unit.

    With ``t = time_unit_s tau`` the mass is multiplied by the square of the unit and the damping by the unit.
    The input map is measured with inputs as large as the region's; for an input that acts differently with
    either sign it is the mean over the signs that the region has.
    """
    unit = float(lagrangian.time_unit_s)
    size = np.sqrt(np.mean(region.u**2, axis=0)) + 1e-12
    signs = [tuple(s for s in (1.0, -1.0) if (s * column > 0.0).any()) for column in region.u.T]

    @torch.no_grad()
    def minus_conservative_force(q: np.ndarray, u: np.ndarray) -> np.ndarray:
        ready = lagrangian.prepare()
        parts = [
            -lagrangian.conservative_force(torch.as_tensor(a), torch.as_tensor(b), ready)
            for a, b in zip(_batches(q), _batches(u), strict=True)
        ]
        return torch.cat(parts).double().numpy()

    def potential_gradient(q: np.ndarray) -> np.ndarray:
        return minus_conservative_force(q, np.zeros((len(q), lagrangian.n_inputs)))

    def input_map(q: np.ndarray) -> np.ndarray:
        forces, unloaded = np.zeros((len(q), lagrangian.n_inputs, lagrangian.d)), potential_gradient(q)
        for c, own_signs in enumerate(signs):
            for sign in own_signs or (1.0,):
                u = np.zeros((len(q), lagrangian.n_inputs))
                u[:, c] = sign * size[c]
                difference = unloaded - minus_conservative_force(q, u)
                forces[:, c] += difference / (sign * size[c]) / max(len(own_signs), 1)
        return forces

    @torch.no_grad()
    def mass(q: np.ndarray) -> np.ndarray:
        parts = [lagrangian.mass(torch.as_tensor(a)) for a in _batches(q)]
        return unit**2 * torch.cat(parts).double().numpy()

    @torch.no_grad()
    def dissipation(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        parts = [lagrangian.damping(torch.as_tensor(a)) for a in _batches(q)]
        return unit * np.einsum("nij,nj->ni", torch.cat(parts).double().numpy(), v)

    return FieldFunctions(mass, potential_gradient, input_map, dissipation)


def make_encoder(autoencoder: Autoencoder, chart: Chart, *, what: str) -> Callable[[np.ndarray], np.ndarray]:
    """A function from frames (T, H, W, 3), uint8, to whitened latents (T, d) of a run, not smoothed.

    It raises a ValueError on frames of another size than the run's; ``what`` names the run in the message.
    """

    def encode(frames: np.ndarray) -> np.ndarray:
        size, fitted = tuple(frames.shape[1:3]), (autoencoder.height, autoencoder.width)
        if size != fitted:
            raise ValueError(
                f"{what}: was fitted to frames of {fitted[0]} x {fitted[1]} px, but these are "
                f"{size[0]} x {size[1]}; read the video with the run's own settings"
            )
        return chart.to_whitened(encode_frames(autoencoder, frames))

    return encode


def encode_recording(autoencoder: Autoencoder, chart: Chart, recording: Recording) -> Trajectory:
    """Encode a video as a trajectory of whitened latents, not smoothed, with its clips, times and inputs.

    Raises:
        ValueError: the video has another number of inputs than the run, or frames of another size.
    """
    n_u, source = chart.inputs.shape[1], str(recording.meta.get("source", "recording"))
    if recording.inputs.shape[1] != n_u:
        raise ValueError(
            f"{source}: {recording.inputs.shape[1]} input(s), but the run was fitted with {n_u}; give the "
            "inputs in a CSV of the same stem with columns t, u0, ..."
        )
    latents = make_encoder(autoencoder, chart, what="the run")(np.asarray(recording.frames[:]))
    return make_video_trajectory(recording, latents, source=source)


def read_chart_trajectory(chart: Chart, *, held_out: bool) -> Trajectory:
    """The trajectory that a run was fitted to: its held-out part, or its training part.

    Raises:
        ValueError: that part has no frame.
    """
    start, stop = (chart.n_train, len(chart.latents)) if held_out else (0, chart.n_train)
    part = chart.held_out if held_out else chart.train
    if not part.segments:
        raise ValueError("the run holds no frame out of its training; give another recording as real=")
    kept = np.concatenate([np.arange(a, b) for a, b in part.segments])
    lengths = np.cumsum([0, *(b - a for a, b in part.segments)])
    return Trajectory(
        time_s=chart.time_s[start:stop][kept],
        q=part.latents[kept],
        u=part.inputs[kept],
        segments=tuple((int(a), int(b)) for a, b in pairwise(lengths)),
        source="held-out part" if held_out else "training part",
    )


def _batches(x: np.ndarray) -> list[np.ndarray]:
    return [x[i : i + BATCH_SIZE] for i in range(0, len(x), BATCH_SIZE)]
