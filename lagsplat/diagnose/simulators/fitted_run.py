"""A sim that is a fitted run: its Lagrangian in whitened latents and seconds, and recordings in these."""

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

BATCH_SIZE = 256
"""States that a network evaluates at once, to bound the memory."""


def load_run_dynamics(folder: Path) -> Lagrangian:
    """The Lagrangian of the run in ``folder``.

    Raises:
        FileNotFoundError: it is neither there nor in the two folders above.
    """
    for place in (folder, *folder.resolve().parents[:2]):
        if (place / "dynamics.safetensors").is_file():
            return load_dynamics(place / "dynamics.safetensors")[0]
    raise FileNotFoundError(
        f"{folder}: no dynamics.safetensors there or up to two folders above; give the folder of a "
        "finished fit"
    )


def project_run(lagrangian: Lagrangian, region: OperatingRegion, *, what: str) -> ProjectedModel:
    """The model of a fitted Lagrangian over a region of whitened latents, per second.

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
    """Mass, forces and input map of a Lagrangian in seconds; energies keep the Lagrangian's own unit.

    With ``t = time_unit_s tau`` the mass takes the square of the unit and the damping the unit itself. The
    input map is measured with inputs of the size of the region's; one that acts otherwise with the other sign
    gets the mean of both if the region has both.
    """
    unit = float(lagrangian.time_unit_s)
    size = np.sqrt(np.mean(region.u**2, axis=0)) + 1e-12
    signs = [(s for s in (1.0, -1.0) if (s * column > 0.0).any()) for column in region.u.T]
    pushes = [tuple(own) for own in signs]

    @torch.no_grad()
    def slope(q: np.ndarray, u: np.ndarray) -> np.ndarray:
        ready = lagrangian.prepare()
        parts = [
            -lagrangian.conservative_force(torch.as_tensor(a), torch.as_tensor(b), ready)
            for a, b in zip(_batches(q), _batches(u), strict=True)
        ]
        return torch.cat(parts).double().numpy()

    def still(q: np.ndarray) -> np.ndarray:
        return slope(q, np.zeros((len(q), lagrangian.n_inputs)))

    def reach(q: np.ndarray) -> np.ndarray:
        out, base = np.zeros((len(q), lagrangian.n_inputs, lagrangian.d)), still(q)
        for c, own in enumerate(pushes):
            for sign in own or (1.0,):
                u = np.zeros((len(q), lagrangian.n_inputs))
                u[:, c] = sign * size[c]
                out[:, c] += (base - slope(q, u)) / (sign * size[c]) / max(len(own), 1)
        return out

    @torch.no_grad()
    def mass(q: np.ndarray) -> np.ndarray:
        parts = [lagrangian.mass(torch.as_tensor(a)) for a in _batches(q)]
        return unit**2 * torch.cat(parts).double().numpy()

    @torch.no_grad()
    def loss(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        parts = [lagrangian.damping(torch.as_tensor(a)) for a in _batches(q)]
        return unit * np.einsum("nij,nj->ni", torch.cat(parts).double().numpy(), v)

    return FieldFunctions(mass, still, reach, loss)


def make_encoder(autoencoder: Autoencoder, chart: Chart, *, what: str) -> Callable[[np.ndarray], np.ndarray]:
    """From frames (T, H, W, 3), uint8, to whitened latents (T, d) of a run, not smoothed.

    Raises:
        ValueError: on frames of another size than the run's.
    """

    def encode(frames: np.ndarray) -> np.ndarray:
        size, own = tuple(frames.shape[1:3]), (autoencoder.height, autoencoder.width)
        if size != own:
            raise ValueError(
                f"{what}: was fitted to pictures of {own[0]} x {own[1]} px, but these are "
                f"{size[0]} x {size[1]}; read the film with the run's own settings"
            )
        return chart.to_whitened(encode_frames(autoencoder, frames))

    return encode


def encode_recording(autoencoder: Autoencoder, chart: Chart, recording: Recording) -> Trajectory:
    """A film as whitened latents of a run, not smoothed, with its own clips, times and inputs.

    Raises:
        ValueError: the film has another number of inputs than the run, or pictures of another size.
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
    """The recording a run was fitted to: its held-out part, for the self mode, or its training part.

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
