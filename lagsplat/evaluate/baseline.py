"""A baseline under the protocol of every other model."""

import time
from typing import Any

import numpy as np
import torch

from lagsplat.baselines.delays import delayed, standing
from lagsplat.baselines.model import Baseline
from lagsplat.chart.clock import read_clock
from lagsplat.chart.visibility import visibility
from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.evaluate import recorded
from lagsplat.evaluate.protocol import STENCILS, HeldOut, Integrate, Pictures, Render, Velocities
from lagsplat.evaluate.score import Subject, score
from lagsplat.forces.of_baselines import ASKED, reach
from lagsplat.io.recording import Recording

CHUNK = 128  # images encoded or drawn at once: bounds memory, not results
SEEN = 64  # training frames at which the visibility of the coordinates is measured
STEP = 2e-2  # of those differences, in units of the latent prior


def evaluate_baseline(baseline: Baseline, recording: Recording, config: EvaluateConfig) -> dict[str, Any]:
    """Every score of a baseline on the held-out part of a recording, ready for JSON.

    States are encoded means and start with the encoder's own velocity, in the direction that the image takes
    to the next frame where the protocol is ``forward``, as published, and else over the neighbours. Inputs
    are as measured. Frames, starts and horizons are those of every other model on this recording.

    Raises:
        ValueError: the model is for frames or inputs of another shape, or the held-out part is too short.
    """
    begin = time.perf_counter()
    subject = baseline_subject(baseline, recording, config)
    return {
        **score(subject, recording, config),
        "linear_modes": modes_of(baseline),
        "wall_time_s": time.perf_counter() - begin,
    }


def baseline_subject(baseline: Baseline, recording: Recording, config: EvaluateConfig) -> Subject:
    """A baseline on the held-out part of a recording, as the scores know it.

    Raises:
        ValueError: the model is for frames or inputs of another shape.
    """
    require_same_shape(baseline, recording)
    pictures = recorded(recording, first=recording.split()[0].n_frames)
    held = held_out_of(baseline, recording, pictures, config)
    asked = torch.from_numpy(held.latents[:: max(1, held.n_frames // ASKED)]).float()
    return Subject(
        d=baseline.architecture.d,
        dynamics="linear",
        external_force=reach(baseline, asked),
        held=held,
        pictures=pictures,
        render=renderer(baseline),
        integrate=integrator(baseline),
    )


def require_same_shape(baseline: Baseline, recording: Recording) -> None:
    """Check that the model can see this recording.

    Raises:
        ValueError: frames or inputs are of another shape.
    """
    of = baseline.architecture
    shape = (recording.height, recording.width, recording.inputs.shape[1])
    if shape != (of.height, of.width, of.n_inputs):
        raise ValueError(
            f"the recording has frames of {shape[0]} x {shape[1]} and {shape[2]} inputs, the baseline takes "
            f"{of.height} x {of.width} and {of.n_inputs}; check that its weights are of this system"
        )


def held_out_of(
    baseline: Baseline, recording: Recording, pictures: Pictures, config: EvaluateConfig
) -> HeldOut:
    """The held-out part as this model encodes it: latents not smoothed, inputs with their delays."""
    train, part = recording.split()
    samples, first = baseline.architecture.samples, train.n_frames
    clock = read_clock(recording.time_s, recording.segments)
    latents = encode(baseline, pictures, np.arange(part.n_frames))
    seen = np.random.default_rng(config.seed).choice(first, min(SEEN, first), replace=False)
    z = encode(baseline, recorded(recording, first=0), np.sort(seen))
    visible = visibility(lambda q: baseline.decode(q.float()), z, step=STEP)
    fed = delayed(recording.inputs, samples=samples, segments=recording.segments)
    return HeldOut(
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
        velocities=velocities_of(baseline, pictures, part, forward=config.velocity == "forward"),
        standing=standing(part.inputs, samples=samples),
    )


@torch.no_grad()
def encode(baseline: Baseline, pictures: Pictures, frames: np.ndarray) -> np.ndarray:
    """Encoded means of frames, (N, d)."""
    rows = [
        baseline.encoder(torch.from_numpy(pictures(part)))[0].double().numpy()
        for part in np.array_split(frames, max(1, len(frames) // CHUNK))
    ]
    return np.concatenate(rows)


def velocities_of(baseline: Baseline, pictures: Pictures, part: Recording, *, forward: bool) -> Velocities:
    """The encoder's own velocity at frames of the held-out part, by true times.

    The image's rate of change is the difference to the next frame, or over both neighbours; at the ends of a
    clip it is the difference to the one neighbour there is.
    """
    ends = np.concatenate([[start, stop - 1] for start, stop in part.segments])
    first, last = ends[0::2], ends[1::2]

    @torch.no_grad()
    def velocities(frames: np.ndarray) -> np.ndarray:
        after = np.where(np.isin(frames, last), frames, frames + 1)
        before = frames if forward else np.where(np.isin(frames, first), frames, frames - 1)
        before = np.where(np.isin(frames, last), np.maximum(frames - 1, 0), before)
        elapsed = (part.time_s[after] - part.time_s[before])[:, None, None, None]
        rates = torch.from_numpy((pictures(after) - pictures(before)) / elapsed).float()
        return baseline.encoder.moving(torch.from_numpy(pictures(frames)), rates)[2].double().numpy()

    return velocities


def renderer(baseline: Baseline) -> Render:
    """Images drawn at latents."""

    @torch.no_grad()
    def render(z: np.ndarray) -> np.ndarray:
        parts = torch.from_numpy(z).float().split(CHUNK)
        return torch.cat([baseline.decode(part) for part in parts]).numpy()

    return render


def integrator(baseline: Baseline) -> Integrate:
    """Rollouts of the law, which knows steps of one frame only."""

    @torch.no_grad()
    def integrate(
        z0: np.ndarray, v0: np.ndarray, inputs: np.ndarray, steps_s: float | np.ndarray
    ) -> np.ndarray:
        start = (torch.from_numpy(values).float() for values in (z0, v0, inputs))
        return baseline.rollout(*start)[0].double().numpy()

    return integrate


def modes_of(baseline: Baseline) -> list[dict[str, float]]:
    """Frequencies and decay rates of the one-step map, slowest first.

    An eigenvalue that does not oscillate has frequency 0; one that has died within a step, an infinite rate.
    """
    with torch.no_grad():
        values = np.linalg.eigvals(baseline.dynamics.transition().double().numpy())
    with np.errstate(divide="ignore"):
        rates = np.log(values.astype(complex)) / baseline.architecture.dt_s
    found = [
        {"frequency_hz": float(abs(rate.imag) / (2 * np.pi)), "rate_per_s": float(-rate.real)}
        for rate in rates
        if rate.imag >= 0
    ]
    return sorted(found, key=lambda mode: (mode["frequency_hz"], mode["rate_per_s"]))
