"""Measure frequency, decay and amplitude of a motion; every model gets the same estimators."""

from typing import Any

import numpy as np
from jaxtyping import Float64
from scipy.optimize import least_squares

from lagsplat.evaluate.modes import fit_modes

LEAST_CYCLES = 1.0
STRONGEST = 0.2  # share of a series' energy below which the fitted oscillation does not represent its motion
LAGS = 0.25  # share of a series up to which the autocorrelation of its residual is summed


def fit_oscillation(
    series: Float64[np.ndarray, "N d"], *, dt_s: float, metric: Float64[np.ndarray, "d d"]
) -> dict[str, float] | None:
    """Fit a damped oscillation to a series, evenly spaced by ``dt_s``, with one-sigma uncertainties.

    ``rate_per_s`` is the decay rate of the envelope, 1 / tau, and ``frequency_hz`` the mean frequency. The
    model has one exponential envelope and one phase whose frequency may drift linearly, as a pendulum's does
    while it decays; two fixed frequencies would turn such a drift into a wrong decay. None where nothing
    oscillates. Uncertainties are those of least squares with the autocorrelation of the residual included.
    """
    if len(series) < 12 or not np.isfinite(series).all():
        return None
    visible = series @ np.linalg.eigh(metric)[1][:, -1]
    scale = float(np.ptp(visible))
    modes = fit_modes(series, dt_s=dt_s, metric=metric, most=1) if scale > 0 else ()
    if not modes:
        return None
    signal, span_s = (visible - visible.mean()) / scale, (len(visible) - 1) * dt_s
    time = np.linspace(-0.5, 0.5, len(signal))  # in spans, centred: there the phase terms are independent
    start = np.array([_envelope(signal), 2 * np.pi * modes[0].frequency_hz * span_s, 0.0])
    fit = least_squares(lambda x: _missed(x, signal, time), start, method="lm", max_nfev=400)
    rate, omega, _ = fit.x
    left = float(np.sum(fit.fun**2) / np.sum(signal**2))
    if abs(omega) / (2 * np.pi) < LEAST_CYCLES or left > 1 - STRONGEST:
        return None
    spread = np.sqrt(np.diag(np.linalg.pinv(fit.jac.T @ fit.jac)) * _noise(fit.fun))
    return {
        "frequency_hz": float(abs(omega) / (2 * np.pi * span_s)),
        "frequency_sigma": float(spread[1] / (2 * np.pi * span_s)),
        "rate_per_s": float(rate / span_s),
        "rate_sigma": float(spread[0] / span_s),
    }


def _envelope(signal: np.ndarray) -> float:
    """Decay over the span, from the energies of its two halves."""
    first, second = (float(np.mean(half**2)) for half in np.array_split(signal, 2))
    return float(np.clip(np.log(max(first, 1e-12) / max(second, 1e-12)), -8.0, 8.0))


def _missed(parameters: np.ndarray, signal: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Residual after an oscillation of given (decay, phase, frequency drift) over the span."""
    rate, omega, drift = parameters
    wave = np.exp(np.clip(-rate * time, -50.0, 50.0)) * np.exp(1j * (omega * time + drift * time**2))
    basis = np.linalg.qr(np.stack([np.ones_like(time), wave.real, wave.imag], axis=1))[0]
    return signal - basis @ (basis.T @ signal)


def _noise(residual: np.ndarray) -> float:
    """Variance of a residual times one plus twice its autocorrelations, as for the variance of a mean."""
    variance = float(np.sum(residual**2)) / max(len(residual) - 6, 1)
    most = max(1, int(LAGS * len(residual)))
    power = float(np.sum(residual**2)) or 1.0
    memory = [float(residual[:-lag] @ residual[lag:]) / power for lag in range(1, most)]
    return variance * max(1.0, 1.0 + 2.0 * float(np.sum(np.clip(memory, 0.0, None))))


def compare_oscillations(
    encoded: dict[str, float] | None, predicted: dict[str, float] | None
) -> dict[str, Any]:
    """Relative errors of frequency and decay rate against the encoded motion, each with one sigma.

    Signs are kept: a negative ``rate_error`` is too little damping. None where either motion does not
    oscillate, with the ``reason``.
    """
    names = ("frequency_error", "frequency_error_sigma", "rate_error", "rate_error_sigma")
    if encoded is None or predicted is None:
        side = "encoded" if encoded is None else "predicted"
        return dict.fromkeys(names) | {"reason": f"the {side} motion shows no oscillation"}
    result: dict[str, Any] = {"reason": ""}
    for quantity, value in (("frequency", "frequency_hz"), ("rate", "rate_per_s")):
        name, sigma = f"{quantity}_error", f"{quantity}_sigma"
        if not encoded[value] > 0.0:
            result |= {name: None, f"{name}_sigma": None, "reason": "the encoded motion does not decay"}
            continue
        error = (predicted[value] - encoded[value]) / encoded[value]
        # error propagation of the quotient, to first order
        spread = np.hypot(predicted[sigma], encoded[sigma] * predicted[value] / encoded[value])
        result |= {name: float(error), f"{name}_sigma": float(spread / encoded[value])}
    return result


def measure_amplitude(series: Float64[np.ndarray, "N d"], metric: Float64[np.ndarray, "d d"]) -> float:
    """Half the range of the most visible coordinate of a series, in whitened units; NaN if not finite."""
    visible = series @ np.linalg.eigh(metric)[1][:, -1]
    return float(np.ptp(visible) / 2) if np.isfinite(visible).all() else float("nan")
