"""Frequency, decay and what is left of a motion: one estimator each, for every model alike."""

from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.evaluate.damping import plain_mode
from lagsplat.evaluate.modes import fit_modes

NAMES = ("frequency_hz", "frequency_sigma", "rate_per_s", "rate_sigma")


def oscillation(
    series: Float64[np.ndarray, "N d"], *, dt_s: float, metric: Float64[np.ndarray, "d d"]
) -> dict[str, float] | None:
    """The one damped oscillation of a series, evenly spaced by ``dt_s``, with one-sigma uncertainties.

    ``rate_per_s`` is the decay rate of the envelope, 1 / tau. None where nothing oscillates.
    """
    if not np.isfinite(series).all():
        return None
    modes = fit_modes(series, dt_s=dt_s, metric=metric, most=1)
    if not modes:
        return None
    plain = plain_mode(modes[0])
    return {name: plain[name] for name in NAMES}


def compare_oscillations(
    encoded: dict[str, float] | None, predicted: dict[str, float] | None
) -> dict[str, Any]:
    """Relative errors of frequency and decay rate against the encoded motion, each with one sigma.

    The signs stay: a negative ``rate_error`` is too little damping. None where either side shows no
    oscillation, with the ``reason``.
    """
    names = ("frequency_error", "frequency_error_sigma", "rate_error", "rate_error_sigma")
    if encoded is None or predicted is None:
        side = "encoded" if encoded is None else "predicted"
        return dict.fromkeys(names) | {"reason": f"the {side} motion shows no oscillation"}
    result: dict[str, Any] = {"reason": ""}
    for name, value, sigma in (
        ("frequency_error", "frequency_hz", "frequency_sigma"),
        ("rate_error", "rate_per_s", "rate_sigma"),
    ):
        if not encoded[value] > 0.0:
            result |= {name: None, f"{name}_sigma": None, "reason": "the encoded motion does not decay"}
            continue
        error = (predicted[value] - encoded[value]) / encoded[value]
        # of the quotient, to first order
        spread = np.hypot(predicted[sigma], encoded[sigma] * predicted[value] / encoded[value])
        result |= {name: float(error), f"{name}_sigma": float(spread / encoded[value])}
    return result


def amplitude(series: Float64[np.ndarray, "N d"], metric: Float64[np.ndarray, "d d"]) -> float:
    """Half the range of the most visible coordinate of a series, in whitened units; NaN if not finite."""
    visible = series @ np.linalg.eigh(metric)[1][:, -1]
    return float(np.ptp(visible) / 2) if np.isfinite(visible).all() else float("nan")
