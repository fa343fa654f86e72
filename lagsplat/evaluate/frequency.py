"""Free-oscillation frequency: rolled out against encoded, over every usable window."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.free import FreeWindow

RESOLVED = 0.1
SPECTRAL = "spectral peak, most visible mode"
WEIGHTED = "spectral peak, metric-weighted"
FITTED = "damped-sinusoid fit"


def compare_frequency(windows: Sequence[FreeWindow], reason: str, *, dt_s: float) -> dict[str, Any]:
    """Relative frequency error of the rollouts, with every window listed.

    ``value`` is the mean over windows of ``|f_rollout - f_encoded| / f_encoded`` by the spectral peak of the
    most visible mode. A window counts for an estimator when the encoded side is resolved (the estimate's own
    uncertainty is below a tenth of it); only if no window is, the damped fit takes over: ``estimator`` says
    which one speaks. A rollout that shows no oscillation, or diverges, errs by 1. ``low`` and ``high`` are
    two standard errors: over windows if there are several, else of the one window's two estimates. One window
    is a point, and ``note`` says so. Without any usable window ``value`` is None and ``reason`` says why.

    Source: paper, Metrics, free-oscillation frequency error.
    """
    rows = [_row(window, dt_s) for window in windows]
    scores = {name: _score(rows, name) for name in (SPECTRAL, FITTED, WEIGHTED)}
    chosen = next((name for name in (SPECTRAL, FITTED) if scores[name] is not None), None)
    best = scores[chosen] if chosen else None
    if best is None:
        empty = dict.fromkeys(("value", "low", "high", "signed", "encoded_hz", "rollout_hz"))
        why = reason or "no window resolves a frequency on the encoded side"
        return {**empty, "estimator": None, "n_windows": 0, "note": "", "reason": why, "windows": rows}
    return {
        **best,
        "estimator": chosen,
        "note": "single window: a point" if best["n_windows"] == 1 else "",
        "reason": "",
        "others": {name: score for name, score in scores.items() if score is not None and name != chosen},
        "windows": rows,
    }


def natural_period(frequency: dict[str, Any], config: EvaluateConfig) -> float | None:
    """The natural period [s], imposed or else measured by `compare_frequency`; None without either."""
    measured = frequency["encoded_hz"]
    return config.period_s or (1.0 / measured if measured else None)


def _row(window: FreeWindow, dt_s: float) -> dict[str, Any]:
    sides = {
        "encoded": (window.encoded_peak, window.encoded_modes),
        "rollout": (window.simulated_peak, window.simulated_modes),
    }
    row: dict[str, Any] = {
        "start": window.start,
        "frames": len(window.encoded),
        "seconds": len(window.encoded) * dt_s,
        "diverged": window.diverged,
    }
    for name, (peak, modes) in sides.items():
        row[name] = {
            SPECTRAL: [peak.visible_hz, peak.uncertainty_hz],
            WEIGHTED: [peak.weighted_hz, peak.uncertainty_hz],
            FITTED: [modes[0].frequency_hz, modes[0].frequency_sigma_hz] if modes else [None, None],
        }
    return row


def _score(rows: Sequence[dict[str, Any]], estimator: str) -> dict[str, Any] | None:
    """Mean error of one estimator over the windows whose encoded side it resolves."""
    pairs = []
    for row in rows:
        (observed, doubt), (predicted, doubt_too) = row["encoded"][estimator], row["rollout"][estimator]
        if observed is None or doubt is None or not doubt < RESOLVED * observed:
            continue
        shift = -1.0 if predicted is None else (predicted - observed) / observed
        pairs.append((observed, predicted, shift, np.hypot(doubt, doubt_too or 0.0) / observed))
    if not pairs:
        return None
    error = np.array([abs(shift) for _, _, shift, _ in pairs])
    several = len(error) > 1
    spread = float(error.std(ddof=1) / np.sqrt(len(error)) if several else pairs[0][3])
    predicted_hz = [predicted for _, predicted, _, _ in pairs if predicted is not None]
    return {
        "value": float(error.mean()),
        "low": max(float(error.mean()) - 2 * spread, 0.0),
        "high": float(error.mean()) + 2 * spread,
        "signed": float(np.mean([shift for _, _, shift, _ in pairs])),
        "encoded_hz": float(np.mean([observed for observed, _, _, _ in pairs])),
        "rollout_hz": float(np.mean(predicted_hz)) if predicted_hz else None,
        "n_windows": len(pairs),
    }
