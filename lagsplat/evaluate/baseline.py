"""Score a baseline with the protocol of every other model, and find where it accepts an external force.

A force given in the image moves a baseline only if its decoder maps the force back to the coordinates and
its dynamics turn that into an acceleration. Both are tested numerically.

Source: paper, the last column of Table "Krauss".
"""

import time
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.array_types import Latents
from lagsplat.baselines.model import Baseline, Oscillators, stack_delays
from lagsplat.baselines.networks import AttentionDecoder, compute_centre_jacobian
from lagsplat.chart.trajectory import read_time_base
from lagsplat.chart.visibility import measure_visibility
from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.evaluate import make_picture_reader, score
from lagsplat.evaluate.protocol import STENCILS, EvaluationSeries, EvaluationSubject, Pictures, Velocities
from lagsplat.io.recording.recording import Recording

CHUNK = 128  # images encoded or rendered at once: bounds memory, not results
SAMPLE = 64  # training frames on which the visibility of the coordinates is measured
STEP = 2e-2  # step of the finite differences, in units of the latent prior
PROBED = 8  # states at which the response to a force is tested

Forces = Float[Tensor, "B G 2"]


def evaluate_baseline(baseline: Baseline, recording: Recording, config: EvaluateConfig) -> dict[str, Any]:
    """Every score of a baseline on the held-out part of a recording, ready for JSON.

    States are encoded means with the encoder's velocity estimate: from the image difference to the next
    frame where the protocol is ``forward``, as published, and over both neighbours otherwise. Inputs are as
    measured. Frames, starts and horizons are those of every other model on this recording.

    Raises:
        ValueError: the model is for frames or inputs of another shape, or the held-out part is too short.
    """
    begin = time.perf_counter()
    subject = make_baseline_subject(baseline, recording, config)
    return {
        **score(subject, recording, config),
        "linear_modes": compute_baseline_modes(baseline),
        "wall_time_s": time.perf_counter() - begin,
    }


def make_baseline_subject(
    baseline: Baseline, recording: Recording, config: EvaluateConfig
) -> EvaluationSubject:
    """Bundle a baseline and the held-out part of a recording for `score`.

    Raises:
        ValueError: the model is for frames or inputs of another shape.
    """
    of = baseline.architecture
    shape = (recording.height, recording.width, recording.inputs.shape[1])
    if shape != (of.height, of.width, of.n_inputs):
        raise ValueError(
            f"the recording has frames of {shape[0]} x {shape[1]} and {shape[2]} inputs, the baseline takes "
            f"{of.height} x {of.width} and {of.n_inputs}; check that its weights are of this system"
        )
    pictures = make_picture_reader(recording, first=recording.split()[0].n_frames)
    held = read_held_out(baseline, recording, pictures, config)
    probed = torch.from_numpy(held.latents[:: max(1, held.n_frames // PROBED)]).float()

    @torch.no_grad()
    def render(z: np.ndarray) -> np.ndarray:
        parts = torch.from_numpy(z).float().split(CHUNK)
        return torch.cat([baseline.decode(part) for part in parts]).numpy()

    @torch.no_grad()
    def integrate(z0: np.ndarray, v0: np.ndarray, inputs: np.ndarray, steps_s: Any) -> np.ndarray:
        del steps_s  # the dynamics advance by one frame a step
        start = (torch.from_numpy(values).float() for values in (z0, v0, inputs))
        return baseline.rollout(*start)[0].double().numpy()

    reach = describe_baseline_force_reach(baseline, probed)
    return EvaluationSubject(of.d, "linear", reach, held, pictures, render, integrate)


def read_held_out(
    baseline: Baseline, recording: Recording, pictures: Pictures, config: EvaluateConfig
) -> EvaluationSeries:
    """Encode the held-out part with this model: latents not smoothed, inputs stacked with their delays."""
    train, part = recording.split()
    samples, first = baseline.architecture.samples, train.n_frames
    clock = read_time_base(recording.time_s, recording.segments)
    latents = encode(baseline, pictures, np.arange(part.n_frames))
    sample = np.random.default_rng(config.seed).choice(first, min(SAMPLE, first), replace=False)
    z = encode(baseline, make_picture_reader(recording, first=0), np.sort(sample))
    visible = measure_visibility(lambda q: baseline.decode(q.float()), z, step=STEP)
    fed = stack_delays(recording.inputs, samples=samples, segments=recording.segments)
    return EvaluationSeries(
        encoded=latents,
        latents=latents,
        forcing=fed[first:],
        inputs=part.inputs,
        segments=part.segments,
        metric=visible.metric,
        dt_s=clock.dt_s,
        skip=round(config.skip_s / clock.dt_s),
        time_s=None if clock.time_s is None else part.time_s,
        stencil=STENCILS[config.velocity],
        velocities=estimate_velocities(baseline, pictures, part, forward=config.velocity == "forward"),
        standing=np.tile(part.inputs, (1, samples)),
    )


@torch.no_grad()
def encode(baseline: Baseline, pictures: Pictures, frames: np.ndarray) -> np.ndarray:
    """Encoded means (N, d) of the frames with these numbers."""
    parts = np.array_split(frames, max(1, len(frames) // CHUNK))
    means = [baseline.encoder(torch.from_numpy(pictures(part)))[0] for part in parts]
    return torch.cat(means).double().numpy()


def estimate_velocities(
    baseline: Baseline, pictures: Pictures, part: Recording, *, forward: bool
) -> Velocities:
    """A function that returns the encoder's velocity estimate at held-out frames, on true times.

    The image's rate of change is the difference to the next frame (``forward``) or over both neighbours; at
    the ends of a clip it is the difference to the only neighbour.
    """
    first, stops = np.array(part.segments).T
    last = stops - 1

    @torch.no_grad()
    def velocities(frames: np.ndarray) -> np.ndarray:
        after = np.where(np.isin(frames, last), frames, frames + 1)
        before = frames if forward else np.where(np.isin(frames, first), frames, frames - 1)
        before = np.where(np.isin(frames, last), np.maximum(frames - 1, 0), before)
        elapsed = (part.time_s[after] - part.time_s[before])[:, None, None, None]
        rates = torch.from_numpy((pictures(after) - pictures(before)) / elapsed).float()
        return baseline.encoder.moving(torch.from_numpy(pictures(frames)), rates)[2].double().numpy()

    return velocities


def compute_baseline_modes(baseline: Baseline) -> list[dict[str, float]]:
    """Frequencies and decay rates of the one-step map, slowest first.

    An eigenvalue that does not oscillate has frequency 0; one that vanishes within a step, an infinite rate.
    """
    with torch.no_grad():
        values = np.linalg.eigvals(baseline.dynamics.transition().double().numpy())
    with np.errstate(divide="ignore"):
        rates = np.log(values.astype(complex)) / baseline.architecture.dt_s
    modes = [
        {"frequency_hz": float(abs(rate.imag) / (2 * np.pi)), "rate_per_s": float(-rate.real)}
        for rate in rates
        if rate.imag >= 0
    ]
    return sorted(modes, key=lambda mode: (mode["frequency_hz"], mode["rate_per_s"]))


def pull_back_force(baseline: Baseline, z: Latents, forces: Forces) -> Latents | None:
    """Map forces ``(y, x)`` on the centres of the attention maps to forces on the coordinates.

    None where the decoder has no such centres. A planar node has one centre for its two coordinates, so the
    map between them is square. A decoder with one map per coordinate gives no planar position to push.
    """
    if not isinstance(baseline.decoder, AttentionDecoder) or baseline.decoder.group != 2:
        return None
    return torch.einsum("bgcd,bgc->bd", compute_centre_jacobian(baseline.decoder, z), forces)


def accelerate_baseline(baseline: Baseline, z: Latents, push: Latents) -> Latents | None:
    """The acceleration [1/s^2] that a force on the coordinates adds; None if the dynamics take no force."""
    law = baseline.dynamics
    if not isinstance(law, Oscillators):
        return None
    architecture, still = baseline.architecture, torch.zeros_like(z)
    u = torch.zeros(len(z), architecture.samples * architecture.n_inputs)
    return (law(z, still, u, push)[1] - law(z, still, u)[1]) / law.dt_s


@torch.no_grad()
def describe_baseline_force_reach(baseline: Baseline, z: Latents) -> str:
    """Where a push acts at the states ``z``: ``none``, ``latent only``, or at how many centres."""
    answer = accelerate_baseline(baseline, z, torch.ones_like(z))
    if answer is None or not _moves(answer):
        return "none"
    nodes = baseline.decoder.n_nodes if isinstance(baseline.decoder, AttentionDecoder) else 0
    reached = 0
    for node in range(nodes):
        forces = torch.zeros(len(z), nodes, 2)
        forces[:, node] = 1.0
        push = pull_back_force(baseline, z, forces)
        answer = None if push is None else accelerate_baseline(baseline, z, push)
        reached += answer is not None and _moves(answer)
    return f"at {reached} centres" if reached else "latent only"


def _moves(acceleration: Tensor) -> bool:
    return bool(torch.isfinite(acceleration).all() and acceleration.abs().amax() > 0)
