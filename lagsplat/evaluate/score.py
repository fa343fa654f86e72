"""The scores that every model gets alike: the same starts, the same frames, the same estimators."""

from dataclasses import dataclass
from typing import Any

from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.damping import compare_decay
from lagsplat.evaluate.floor import autoencoder_floor
from lagsplat.evaluate.forecast import image_forecast
from lagsplat.evaluate.free import free_windows
from lagsplat.evaluate.frequency import compare_frequency, natural_period
from lagsplat.evaluate.horizon import error_along
from lagsplat.evaluate.latent import latent_forecast
from lagsplat.evaluate.protocol import HeldOut, Integrate, Pictures, Render
from lagsplat.io.recording import Recording

SCHEMA = 2


@dataclass(frozen=True)
class Subject:
    """A model on the held-out part of a recording, as far as the scores know it.

    ``dynamics`` names the kind of its law, ``external_force`` says where a force given in the image can act.
    """

    d: int
    dynamics: str
    external_force: str
    held: HeldOut
    pictures: Pictures
    render: Render
    integrate: Integrate


def score(
    subject: Subject,
    recording: Recording,
    config: EvaluateConfig,
) -> dict[str, Any]:
    """Every score of a model as plain data: the table's numbers, their intervals, the blocks behind them.

    Raises:
        ValueError: the held-out part is too short for the protocol.
    """
    held, pictures, render, integrate = subject.held, subject.pictures, subject.render, subject.integrate
    floor = autoencoder_floor(held, pictures, render, most=config.floor_frames)
    forecast = image_forecast(held, pictures, render, integrate, config)
    windows, reason = free_windows(held, integrate, config)
    frequency = compare_frequency(windows, reason, dt_s=held.dt_s)
    period_s = natural_period(frequency, config)
    latent: dict[str, Any] = {"reason": f"no natural period: {frequency['reason']}; set evaluate.period_s"}
    if period_s is not None:
        latent = latent_forecast(held, pictures, render, integrate, config, period_s=period_s)
        latent["period_from"] = "evaluate.period_s" if config.period_s else frequency["estimator"]
    return {
        "schema": SCHEMA,
        "recording": {key: recording.meta.get(key) for key in ("origin", "source", "sha256")},
        "d": subject.d,
        "dynamics": subject.dynamics,
        "n_held_out": held.n_frames,
        "skip_frames": held.skip,
        "dt_s": held.dt_s,
        "scores": _scores(subject, floor, forecast, frequency, latent),
        "intervals": {
            "mse_half_second": [forecast["low"], forecast["high"]],
            "mse_ahead": forecast["ahead_interval"],
            "frequency_error": [frequency["low"], frequency["high"]],
            "latent_nrmse": latent.get("nrmse_interval", [None, None]),
            "image_ratio": latent.get("image_ratio_interval", [None, None]),
        },
        "floor": floor,
        "forecast": forecast,
        "frequency": frequency,
        "damping": compare_decay(windows, reason),
        "latent": latent,
        "horizon": error_along(held, pictures, render, integrate, config),
    }


def _scores(
    subject: Subject,
    floor: dict[str, Any],
    forecast: dict[str, Any],
    frequency: dict[str, Any],
    latent: dict[str, Any],
) -> dict[str, Any]:
    return {
        "ae_floor": floor["value"],
        "mse_half_second": forecast["mse"],
        "mse_ahead": forecast["mse_ahead"],
        "frequency_error": frequency["value"],
        "latent_nrmse": latent.get("nrmse"),
        "image_ratio": latent.get("image_ratio"),
        "external_force": subject.external_force,
        "diverged": forecast["diverged"]
        + latent.get("diverged", 0)
        + sum(row["diverged"] for row in frequency["windows"]),
        "rollouts": forecast["windows"] + latent.get("windows", 0) + len(frequency["windows"]),
    }
