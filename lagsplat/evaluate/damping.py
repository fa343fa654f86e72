"""Decay of free motion: rolled out against encoded, the learned law's own modes, and both against truth."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.evaluate.free import FreeWindow
from lagsplat.evaluate.modes import Mode
from lagsplat.stage2.lagrangian import Lagrangian
from lagsplat.stage2.modes import modes


def compare_decay(windows: Sequence[FreeWindow], reason: str) -> dict[str, Any]:
    """Decay rates [1/s] of the strongest fitted oscillation of each window, encoded and rolled out.

    ``value`` is the relative error of the rollout's rate, the median over windows in which both sides show a
    decaying oscillation; the windows, with one-sigma uncertainties, stand beside it. Windows without one on
    the rollout's side are counted in ``missing``. None with a ``reason`` if no window has both.
    """
    rows: list[dict[str, Any]] = [
        {
            "start": window.start,
            "encoded": _mode(window.encoded_modes),
            "rollout": _mode(window.simulated_modes),
        }
        for window in windows
    ]
    seen = [row for row in rows if row["encoded"] is not None]
    both = [row for row in seen if row["rollout"] is not None and row["encoded"]["rate_per_s"] > 0]
    result: dict[str, Any] = {"windows": rows, "missing": len(seen) - len(both), "n_windows": len(both)}
    if not both:
        why = reason or "no window shows a decaying oscillation on both sides"
        return {"value": None, "encoded_per_s": None, "rollout_per_s": None, "reason": why, **result}
    encoded = np.array([row["encoded"]["rate_per_s"] for row in both])
    rolled = np.array([row["rollout"]["rate_per_s"] for row in both])
    sigma = [np.hypot(row["encoded"]["rate_sigma"], row["rollout"]["rate_sigma"]) for row in both]
    return {
        "value": float(np.median(np.abs(rolled - encoded) / encoded)),
        "sigma": float(np.median(np.array(sigma) / encoded)),
        "encoded_per_s": float(np.median(encoded)),
        "rollout_per_s": float(np.median(rolled)),
        "reason": "",
        **result,
    }


def _mode(modes: tuple[Mode, ...]) -> dict[str, float] | None:
    if not modes:
        return None
    mode = modes[0]
    return {
        "frequency_hz": mode.frequency_hz,
        "frequency_sigma": mode.frequency_sigma_hz,
        "rate_per_s": mode.rate_per_s,
        "rate_sigma": mode.rate_sigma_per_s,
        "share": mode.share,
    }


def linear_modes(lagrangian: Lagrangian) -> list[dict[str, float]]:
    """Modes of the learned law linearised about its equilibrium without inputs, slowest first.

    An overdamped direction appears as two entries of frequency 0.
    """
    found = modes(lagrangian, torch.zeros(lagrangian.n_inputs, dtype=torch.float64))
    return [
        {"frequency_hz": frequency_hz, "rate_per_s": rate_per_s}
        for frequency_hz, rate_per_s in zip(found.frequency_hz, found.decay_per_s, strict=True)
    ]


def compare_with_truth(
    metrics: dict[str, Any],
    *,
    damped_frequencies_hz: Float64[np.ndarray, " m"],
    decay_rates_per_s: Float64[np.ndarray, " m"],
) -> dict[str, Any]:
    """Learned frequency and decay of a simulated system against the truth that training never saw.

    The true mode compared is the one nearest to the frequency encoded on the free windows, or the slowest if
    none was measured. ``rollout`` is the damped fit to the free rollouts, ``linearised`` the nearest mode of
    the learned law, ``encoded`` what the same fit reads off the encoded motion: an error there is the
    estimator's and the chart's, not the dynamics'. Errors are relative; None where nothing was measured.
    """
    seen = metrics["damping"]["windows"]
    measured = {
        side: _median([row[side] for row in seen if row[side] is not None]) for side in ("encoded", "rollout")
    }
    anchor = (
        measured["encoded"]["frequency_hz"] if measured["encoded"] else float(damped_frequencies_hz.min())
    )
    index = int(np.argmin(np.abs(damped_frequencies_hz - anchor)))
    truth = {
        "frequency_hz": float(damped_frequencies_hz[index]),
        "rate_per_s": float(decay_rates_per_s[index]),
    }
    turning = [mode for mode in metrics["linear_modes"] if mode["frequency_hz"] > 0]
    measured["linearised"] = min(
        turning, key=lambda mode: abs(mode["frequency_hz"] - truth["frequency_hz"]), default=None
    )
    return {"truth": truth, "mode": index} | {
        side: None if mode is None else {**mode, **_errors(mode, truth)} for side, mode in measured.items()
    }


def _median(modes: Sequence[dict[str, float]]) -> dict[str, float] | None:
    if not modes:
        return None
    return {key: float(np.median([mode[key] for mode in modes])) for key in ("frequency_hz", "rate_per_s")}


def _errors(mode: dict[str, float], truth: dict[str, float]) -> dict[str, float]:
    return {
        "frequency_error": abs(mode["frequency_hz"] / truth["frequency_hz"] - 1.0),
        "decay_error": abs(mode["rate_per_s"] / truth["rate_per_s"] - 1.0),
    }
