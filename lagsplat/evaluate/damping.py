"""Decay of free motion: rolled out against encoded, and the learned law's own modes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from lagsplat.evaluate.free import FreeWindow
from lagsplat.evaluate.modes import Mode
from lagsplat.stage2.lagrangian import Lagrangian
from lagsplat.stage2.modes import modes


def compare_decay(windows: Sequence[FreeWindow], reason: str) -> dict[str, Any]:
    """Decay rates [1/s] of the strongest fitted oscillation of each window, encoded and rolled out.

    ``value`` is the relative error of the rollout's rate, the median over windows in which both sides show a
    decaying oscillation; the windows, with one-sigma uncertainties and all fitted modes, stand beside it.
    Windows without one on the rollout's side are counted in ``missing``. None with a ``reason`` if no window
    has both.
    """
    rows: list[dict[str, Any]] = [
        {
            "start": window.start,
            "frames": len(window.encoded),
            "encoded": _mode(window.encoded_modes),
            "rollout": _mode(window.simulated_modes),
            "encoded_modes": [plain_mode(mode) for mode in window.encoded_modes],
            "rollout_modes": [plain_mode(mode) for mode in window.simulated_modes],
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
    return plain_mode(modes[0]) if modes else None


def plain_mode(mode: Mode) -> dict[str, float]:
    """A fitted oscillation as plain data."""
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
