"""Export a fitted run: as an MCAP log of frames, states and forecasts, or one state as a PLY of Gaussians."""

import json
import logging
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.chart.chart import Chart
from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.evaluate import require_same_run
from lagsplat.evaluate.protocol import has_diverged, initial_states, select_held_out
from lagsplat.io.files.ply import PlyCloud, write_cloud
from lagsplat.io.robot_log.write import ImageTopic, NumberTopic, write_mcap
from lagsplat.runs.run import FittedRun
from lagsplat.splat.image_model import ALPHA_MIN
from lagsplat.splat.point_cloud import to_quaternions
from lagsplat.splat.projection import SQUARE
from lagsplat.stage1.autoencoder import Autoencoder, decode_chunks
from lagsplat.stage2.lagrangian import Lagrangian
from lagsplat.stage2.rollout import rollout

BATCH = 64
LEAST_STATES = 3  # the velocity at the start is a difference over three frames
THIN = 1e-3  # [px] Thickness of Gaussians of the picture, and their distance from each other in their order
FLAT = 1e-9  # [px^2] Least variance that is written
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Motion:
    """States and velocities [1/s] at some frames of the recording."""

    frames: np.ndarray
    q: Float64[np.ndarray, "N d"]
    v: Float64[np.ndarray, "N d"]


def export_mcap(run: FittedRun, config: EvaluateConfig, out: Path) -> None:
    """Write ``run`` to a new MCAP file at ``out``.

    Topics: ``/camera/recorded``, ``/camera/reconstruction``, ``/camera/prediction``, ``/latent/encoded``,
    ``/latent/predicted``, ``/energy/encoded``, ``/energy/predicted`` and, where there are any, ``/inputs``.
    Stamps are the times of the frames, after the instant at which the recording's own log began, if it has
    one.

    Raises:
        FileExistsError: something is at ``out``.
        ValueError: the run's parts do not belong together, or its held-out part is too short.
    """
    chart, recording = run.chart, run.recording
    require_same_run(run.autoencoder, chart, recording)
    encoded, predicted = encoded_motion(chart.whole, chart.smoothing_frames), predict(run, config)
    time_s, latents = recording.time_s, chart.latents
    about = {"q": "whitened latent state", "v": "its velocity [1/s]; of encoded states smoothed before"}
    states, forecast = {"q": latents[encoded.frames], "v": encoded.v}, {"q": predicted.q, "v": predicted.v}
    numbers = [
        NumberTopic("/latent/encoded", time_s[encoded.frames], states, about),
        NumberTopic("/latent/predicted", time_s[predicted.frames], forecast, about),
    ]
    time_unit_s = float(run.lagrangian.time_unit_s)
    unit = f"the Lagrangian's own unit of energy, with {time_unit_s:g} s as unit of time"
    about = dict.fromkeys(("kinetic", "potential", "total"), unit)
    about["dissipated_power"] = f"{unit}, per second"
    for name, motion in (("encoded", encoded), ("predicted", predicted)):
        values = energies(run.lagrangian, motion.q, motion.v)
        numbers.append(NumberTopic(f"/energy/{name}", time_s[motion.frames], values, about))
    if recording.input_names:
        columns = {name: recording.inputs[:, i] for i, name in enumerate(recording.input_names)}
        units = dict(zip(recording.input_names, recording.input_units, strict=True))
        numbers.append(NumberTopic("/inputs", time_s, columns, units))
    meta = {**recording.meta, "segments": recording.segments, "dt_s": chart.dt_s}
    write_mcap(
        out,
        pictures=[
            ImageTopic("/camera/recorded", time_s, (np.asarray(frame) for frame in recording.frames)),
            ImageTopic("/camera/reconstruction", time_s, _rendered(run, latents)),
            ImageTopic("/camera/prediction", time_s[predicted.frames], _rendered(run, predicted.q)),
        ],
        numbers=numbers,
        metadata={key: json.dumps(value) for key, value in meta.items()},
        start_ns=int(recording.meta.get("start_ns", 0)),
    )


def encoded_motion(whole: EncodedTrajectory, smoothing_frames: float) -> Motion:
    """Smoothed encoded states and their central differences, of every clip that has two frames or more."""
    smooth = whole.smoothed(smoothing_frames).latents
    clips = [(a, b) for a, b in whole.segments if b - a > 1]
    frames = [np.arange(a, b) for a, b in clips]
    slopes = [np.gradient(smooth[a:b], whole.time_s[a:b], axis=0) for a, b in clips]
    kept = np.concatenate(frames)
    return Motion(kept, smooth[kept], np.concatenate(slopes))


def predict(run: FittedRun, config: EvaluateConfig) -> Motion:
    """One rollout over the longest held-out clip from its first scored frame, never re-anchored.

    It ends where it diverges, which is told. Inputs are the smoothed ones of the recording.

    Raises:
        ValueError: no held-out clip has three frames after ``evaluate.skip_s``.
    """
    chart = run.chart
    held = select_held_out(chart, config)
    start, stop = held.longest
    if stop - start < LEAST_STATES:
        raise ValueError(
            f"the longest held-out clip has {max(0, stop - start)} scored frames, and a prediction takes "
            f"{LEAST_STATES}; lower evaluate.skip_s={config.skip_s} or hold out more"
        )
    q0, v0 = initial_states(held, np.array([start]))
    first = (torch.as_tensor(x) for x in (q0, v0, held.forcing[None, start:stop]))
    steps = held.clock.steps_s(np.array([start]), stop - start)
    dt_s = torch.as_tensor(steps) if isinstance(steps, np.ndarray) else steps
    q, v = (x[0].double().numpy() for x in rollout(run.lagrangian, *first, dt_s=dt_s))
    gone = has_diverged(q, config.divergence_factor * held.reach)
    states = int(np.argmax(gone)) if gone.any() else len(q)
    if states < len(q):
        log.warning(
            "the prediction diverges after %.3f s and ends there",
            held.clock.instants_s(start, states + 1)[-1],
        )
    return Motion(chart.n_train + start + np.arange(states), q[:states], v[:states])


@torch.no_grad()
def energies(
    lagrangian: Lagrangian, q: Float64[np.ndarray, "N d"], v: Float64[np.ndarray, "N d"]
) -> dict[str, Float64[np.ndarray, " N"]]:
    """Kinetic, potential and total energy and the power that damping takes, at velocities [1/s].

    Energies are in the Lagrangian's own unit, whose unit of time is ``time_unit_s``; the power is in that
    unit per second. Without inputs the total falls at the rate of the power.
    """
    unit = float(lagrangian.time_unit_s)
    rows: dict[str, list[np.ndarray]] = {"kinetic": [], "potential": [], "dissipated_power": []}
    for i in range(0, len(q), BATCH):
        at, w = torch.as_tensor(q[i : i + BATCH]), unit * torch.as_tensor(v[i : i + BATCH])
        rows["kinetic"].append(_form(lagrangian.mass(at), w) / 2)
        rows["potential"].append(lagrangian.potential(at).numpy())
        rows["dissipated_power"].append(_form(lagrangian.damping(at), w) / unit)
    joined = {name: np.concatenate(parts).astype(np.float64) for name, parts in rows.items()}
    return joined | {"total": joined["kinetic"] + joined["potential"]}


def _form(matrix: torch.Tensor, w: torch.Tensor) -> np.ndarray:
    return torch.einsum("bi,bij,bj->b", w, matrix.to(w), w).numpy()


def _rendered(run: FittedRun, q: Float64[np.ndarray, "N d"]) -> Iterator[np.ndarray]:
    for images in decode_chunks(run.autoencoder, run.chart.to_raw(q)):
        yield from np.round(255.0 * np.moveaxis(np.clip(images, 0.0, 1.0), 1, 3)).astype(np.uint8)


def export_ply(autoencoder: Autoencoder, chart: Chart, q: Float64[np.ndarray, " d"], out: Path) -> None:
    """Write the Gaussians that are present at the whitened state ``q``.

    Coordinates are those of the film's camera, x to the right, y down, z ahead, in units of the depth of its
    pivot; Gaussians of the picture lie on a plane there, in the order in which they cover each other. The
    background colour is not a Gaussian and is left out.

    Raises:
        ValueError: the state has another dimension, is not finite, or nothing is present there.
    """
    if q.shape != (chart.d,) or not np.isfinite(q).all():
        raise ValueError(f"the state {q.tolist()} is not one of {chart.d} finite coordinates")
    cloud = cloud_at(autoencoder, chart.to_raw(q[None]))
    if not len(cloud.means):
        raise ValueError(f"no Gaussian is present at the state {q.tolist()}: the recording never reached it")
    write_cloud(out, cloud)


@torch.no_grad()
def cloud_at(autoencoder: Autoencoder, z: Float64[np.ndarray, "1 d"]) -> PlyCloud:
    """The Gaussians drawn at a raw latent, in units of the pivot's depth."""
    model = autoencoder.gaussians
    scene = model.condition(torch.from_numpy(z).to(model.center))
    parts = (scene.means[0], scene.covariance, scene.opacity[0])
    means, packed, opacity = (part.double().cpu().numpy() for part in parts)
    if model.space == 3:
        unit = float(autoencoder.filmed_view(model.center).focal[0, 0])
    else:
        # on a plane one picture's width ahead, thin, the first in front
        unit, n = float(autoencoder.width), len(means)
        depth = unit + np.arange(n)[:, None] * THIN / max(n, 1)
        center = 0.5 * np.array([autoencoder.width, autoencoder.height])
        means = np.concatenate([means - center, depth], axis=1)
        packed = np.concatenate([packed, np.zeros((n, 2)), np.full((n, 1), THIN**2)], axis=1)
    values, vectors = np.linalg.eigh(packed[:, SQUARE].reshape(-1, 3, 3))
    shown = opacity >= ALPHA_MIN
    return PlyCloud(
        means=means[shown] / unit,
        scales=np.sqrt(np.maximum(values[shown], FLAT)) / unit,
        quaternions=to_quaternions(vectors[shown]),
        colors=scene.color.double().cpu().numpy()[shown],
        opacities=opacity[shown],
    )
