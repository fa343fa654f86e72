"""All scores of one model, as plain data: the same starts, frames and estimators for every model."""

import time
from typing import Any

import numpy as np
import torch

from lagsplat.chart.chart import Chart
from lagsplat.evaluate import forecast, free_motion
from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.protocol import EvaluationSubject, Integrate, Pictures, Render, select_held_out
from lagsplat.evaluate.truth import inertia_along
from lagsplat.io.recording.recording import Recording
from lagsplat.stage1.autoencoder import Autoencoder, decode_latents
from lagsplat.stage2.config import Degrees
from lagsplat.stage2.lagrangian import Lagrangian
from lagsplat.stage2.rollout import rollout

SCHEMA = 2
LINEAR_LAW = Degrees(potential=2, inputs=1, coordinates=1, matrices=0)
LINEAR = ("constant", "constant", "quadratic", "linear")  # mass, damping, potential, actuation
PROBED = 8  # frames that are encoded again to check that a chart belongs to an autoencoder


def evaluate(
    autoencoder: Autoencoder,
    chart: Chart,
    lagrangian: Lagrangian,
    recording: Recording,
    config: EvaluateConfig,
) -> dict[str, Any]:
    """Every score of a trained run on the held-out part of its recording, ready for JSON.

    ``scores`` holds the table's numbers (None where nothing could be measured; the block of the same name
    says why), ``intervals`` their 95 % intervals over windows; the other blocks hold the details and the
    value of every window. Deterministic but for ``wall_time_s``.

    Raises:
        ValueError: recording, chart and autoencoder do not belong together, or the held-out part is too
            short for the protocol.

    Source: paper, Metrics.
    """
    begin = time.perf_counter()
    subject = make_run_subject(autoencoder, chart, lagrangian, recording, config)
    return {
        **score(subject, recording, config),
        "linear_modes": free_motion.compute_linear_modes(lagrangian),
        "inertia": inertia_along(lagrangian, subject.held.encoded[subject.held.skip :]),
        "wall_time_s": time.perf_counter() - begin,
    }


def make_run_subject(
    autoencoder: Autoencoder,
    chart: Chart,
    lagrangian: Lagrangian,
    recording: Recording,
    config: EvaluateConfig,
) -> EvaluationSubject:
    """Bundle a trained run and the held-out part of its recording for `score`, with arguments as `evaluate`.

    Raises:
        ValueError: recording, chart and autoencoder do not belong together.
    """
    require_same_run(autoencoder, chart, recording)
    return EvaluationSubject(
        d=chart.d,
        dynamics=describe_dynamics(lagrangian),
        external_force=describe_force_reach(autoencoder),
        held=select_held_out(chart, config),
        pictures=make_picture_reader(recording, first=chart.n_train),
        render=lambda q: decode_latents(autoencoder, chart.to_raw(q)),
        integrate=make_integrator(lagrangian),
    )


def score_latent_law(
    autoencoder: Autoencoder,
    chart: Chart,
    recording: Recording,
    config: EvaluateConfig,
    integrate: Integrate,
    *,
    dynamics: str,
    render: Render | None = None,
) -> dict[str, Any]:
    """Every score of another law of the same latents, which knows nothing of forces in the image.

    ``integrate`` rolls the law out, ``dynamics`` names its kind, ``render`` draws states in the place of the
    decoder. Raises as `score`.
    """
    subject = EvaluationSubject(
        d=chart.d,
        dynamics=dynamics,
        external_force="none",
        held=select_held_out(chart, config),
        pictures=make_picture_reader(recording, first=chart.n_train),
        render=render or (lambda q: decode_latents(autoencoder, chart.to_raw(q))),
        integrate=integrate,
    )
    return score(subject, recording, config)


def describe_dynamics(lagrangian: Lagrangian) -> str:
    """The kind of law: ``linear`` or ``nonlinear``, with a mass named that is not learned."""
    form = lagrangian.form
    if form.terms == "polynomial":
        return "linear" if form.degrees == LINEAR_LAW else "nonlinear"
    if (form.mass, form.damping, form.potential, form.actuation) == LINEAR:
        return "linear"
    return "nonlinear" if form.mass == "learned" else f"nonlinear, {form.mass} mass"


def describe_force_reach(autoencoder: Autoencoder) -> str:
    """Where a force given in the image can act: ``anywhere``, or ``none`` if no primitive moves.

    A property of the model, as tested of every baseline: whether its decoder maps such a force to coordinates
    at all. What a force does to the matter of a film, `lagsplat.evaluate.forces` scores.

    Source: paper, the last column of Table "Krauss".
    """
    return "anywhere" if bool(autoencoder.gaussians.jacobian().abs().amax() > 0) else "none"


def require_same_run(autoencoder: Autoencoder, chart: Chart, recording: Recording) -> None:
    """Check that the chart was made by this autoencoder from this recording.

    Raises:
        ValueError: lengths differ, or freshly encoded frames differ from the chart's latents.
    """
    if len(chart.latents) != recording.n_frames:
        raise ValueError(
            f"the chart holds {len(chart.latents)} latents and the recording {recording.n_frames} frames; "
            "make the chart again from this recording"
        )
    probed = np.linspace(0, recording.n_frames - 1, PROBED).astype(np.int64)
    fresh = chart.encode(autoencoder, np.asarray(recording.frames[probed]))
    apart = float(np.abs(fresh - chart.latents[probed]).max())
    if not apart < 1e-2:
        raise ValueError(
            f"freshly encoded frames lie up to {apart:.3g} whitened units from the chart's latents; the "
            "chart belongs to another autoencoder or recording, make it again"
        )


def make_picture_reader(recording: Recording, *, first: int) -> Pictures:
    """A function that returns recorded images in [0, 1]; frame 0 is frame ``first`` of the recording."""

    def pictures(frames: np.ndarray) -> np.ndarray:
        stored = np.asarray(recording.frames[first + frames])
        return np.moveaxis(stored, 3, 1).astype(np.float32) / np.float32(255.0)

    return pictures


def make_integrator(lagrangian: Lagrangian) -> Integrate:
    """A function that rolls out the learned dynamics, with NumPy arrays in and out."""

    def integrate(
        q0: np.ndarray, v0: np.ndarray, inputs: np.ndarray, steps_s: float | np.ndarray
    ) -> np.ndarray:
        dt_s = torch.as_tensor(steps_s) if isinstance(steps_s, np.ndarray) else steps_s
        start = (torch.as_tensor(values) for values in (q0, v0, inputs))
        return rollout(lagrangian, *start, dt_s=dt_s)[0].double().numpy()

    return integrate


def score(subject: EvaluationSubject, recording: Recording, config: EvaluateConfig) -> dict[str, Any]:
    """Every score of a model as plain data: the table's numbers, their intervals, the details behind them.

    Raises:
        ValueError: the held-out part is too short for the protocol.
    """
    held = subject.held
    floor = forecast.measure_autoencoder_floor(subject, most=config.floor_frames)
    images = forecast.image_forecast(subject, config)
    windows, reason = free_motion.cut_free_windows(held, subject.integrate, config)
    frequency = free_motion.compare_frequency(windows, reason, dt_s=held.dt_s)
    period_s = free_motion.measure_natural_period(frequency, config)
    latent: dict[str, Any] = {"reason": f"no natural period: {frequency['reason']}; set evaluate.period_s"}
    if period_s is not None:
        latent = forecast.latent_forecast(subject, config, period_s=period_s)
        latent["period_from"] = "evaluate.period_s" if config.period_s else frequency["estimator"]
    return {
        "schema": SCHEMA,
        "recording": {key: recording.meta.get(key) for key in ("origin", "source", "sha256")},
        "d": subject.d,
        "dynamics": subject.dynamics,
        "n_held_out": held.n_frames,
        "skip_frames": held.skip,
        "dt_s": held.dt_s,
        "scores": {
            "ae_floor": floor["value"],
            "mse_half_second": images["mse"],
            "mse_ahead": images["mse_ahead"],
            "frequency_error": frequency["value"],
            "latent_nrmse": latent.get("nrmse"),
            "image_ratio": latent.get("image_ratio"),
            "external_force": subject.external_force,
            "diverged": images["diverged"]
            + latent.get("diverged", 0)
            + sum(row["diverged"] for row in frequency["windows"]),
            "rollouts": images["windows"] + latent.get("windows", 0) + len(frequency["windows"]),
        },
        "intervals": {
            "mse_half_second": [images["low"], images["high"]],
            "mse_ahead": images["ahead_interval"],
            "frequency_error": [frequency["low"], frequency["high"]],
            "latent_nrmse": latent.get("nrmse_interval", [None, None]),
            "image_ratio": latent.get("image_ratio_interval", [None, None]),
        },
        "floor": floor,
        "forecast": images,
        "frequency": frequency,
        "damping": free_motion.compare_decay(windows, reason),
        "latent": latent,
        "horizon": forecast.error_over_horizon(subject, config),
    }
