"""Frequency and decay of free motion, rolled out against encoded, over windows with constant inputs."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.modes import Mode, fit_modes
from lagsplat.evaluate.protocol import EvaluationSeries, Integrate, has_diverged, initial_states, squared_norm
from lagsplat.evaluate.spectrum import Peak, find_spectral_peak, resample_evenly
from lagsplat.stage2.equilibrium import NoEquilibriumError, linearize_modes
from lagsplat.stage2.lagrangian import Lagrangian

LEAST_WINDOW = 16  # fewest frames of a window
RESOLVED = 0.1  # largest uncertainty of a frequency that is compared, over the frequency
SPECTRAL = "spectral peak, most visible mode"
WEIGHTED = "spectral peak, metric-weighted"
FITTED = "damped-sinusoid fit"


@dataclass(frozen=True)
class FreeMotion:
    """States of a free motion at the frames of a window, with its spectral peaks and fitted oscillations."""

    states: Float64[np.ndarray, "N d"]
    peak: Peak
    modes: tuple[Mode, ...]


@dataclass(frozen=True)
class FreeWindow:
    """A window of free motion as encoded, and rolled out from its first state under constant inputs."""

    start: int
    encoded: FreeMotion
    rollout: FreeMotion
    diverged: bool


def find_free_segments(held: EvaluationSeries, config: EvaluateConfig) -> list[tuple[int, int]]:
    """Half-open ranges of frames over which no input changes, longest first.

    On the measured inputs after the skip, never across clips: every change from frame to frame below
    ``free_rate_fraction`` of the largest peak-to-peak amplitude, total excursion below
    ``free_excursion_fraction`` of it, at least ``free_min_s`` long. Without inputs, or with constant ones,
    every clip is free.
    """
    least = max(round(config.free_min_s / held.dt_s), 1)
    amplitude = float(np.ptp(held.inputs[held.skip :], axis=0).max()) if held.inputs.shape[1] else 0.0
    rate, excursion = config.free_rate_fraction * amplitude, config.free_excursion_fraction * amplitude
    segments: list[tuple[int, int]] = []
    for start, stop in held.clips:
        still = _still(held.inputs[start:stop], rate, excursion) if amplitude else [(0, stop - start)]
        segments += [(start + a, start + b) for a, b in still if b - a >= least]
    return sorted(segments, key=lambda ends: ends[0] - ends[1])[: config.free_max_segments]


def _still(inputs: np.ndarray, rate: float, excursion: float) -> list[tuple[int, int]]:
    """Runs of slow frames, each split where its excursion would exceed the limit."""
    slow = np.abs(np.diff(inputs, axis=0)).max(axis=1) < rate
    runs, start = [], 0
    low = high = inputs[0]
    for frame in range(1, len(inputs)):
        low, high = np.minimum(low, inputs[frame]), np.maximum(high, inputs[frame])
        if not slow[frame - 1] or (high - low).max() >= excursion:
            runs.append((start, frame))
            start, low, high = frame, inputs[frame], inputs[frame]
    return [*runs, (start, len(inputs))]


def cut_free_windows(
    held: EvaluationSeries, integrate: Integrate, config: EvaluateConfig
) -> tuple[list[FreeWindow], str]:
    """Every usable window of free motion, and a sentence saying why there is none (empty otherwise).

    A window lasts ``window_cycles`` cycles of its segment's frequency, at least sixteen frames and at most
    the segment; windows tile it. A segment without a spectral peak takes the frequency of its strongest
    fitted oscillation. Windows whose RMS motion is below ``window_min_amplitude`` of the clip's are left
    out: they contain mostly encoder jitter. The estimators of frequency and decay need even spacing: on an
    uneven clock `resample_evenly` resamples each window, encoded and rolled out.
    """
    segments = find_free_segments(held, config)
    if not segments:
        reason = f"no input stands still for {config.free_min_s} s"
        return [], f"{reason} after the first {held.skip} held-out frames"
    scale = _rms(held.encoded, held.metric)
    windows: list[FreeWindow] = []
    for start, stop in segments:
        even = resample_evenly(held.encoded[start:stop], held.clock, start=start)
        frequency = _peak(held, even, config).visible_hz
        if frequency is None and (modes := _modes(held, even, config)):
            frequency = modes[0].frequency_hz
        if frequency is None:
            continue
        length = min(max(round(config.window_cycles / (frequency * held.dt_s)), LEAST_WINDOW), stop - start)
        loud = [
            s
            for s in range(start, stop - length + 1, length)
            if _rms(held.encoded[s : s + length], held.metric) >= config.window_min_amplitude * scale
        ]
        if loud:
            windows += _roll_out(held, integrate, np.array(loud), length, config)
    if windows:
        return sorted(windows, key=lambda window: window.start), ""
    return [], f"{len(segments)} free segment(s), none with an oscillation above the quietest one allowed"


def _rms(series: np.ndarray, metric: np.ndarray) -> float:
    return float(np.sqrt(squared_norm(series - series.mean(axis=0), metric).mean()))


def _roll_out(
    held: EvaluationSeries, integrate: Integrate, starts: np.ndarray, length: int, config: EvaluateConfig
) -> list[FreeWindow]:
    # A window may end with the clip: the three frames of its velocity stencil still lie inside it.
    q0, v0 = initial_states(held, starts)
    forcing = held.forcing if held.standing is None else held.standing
    frozen = np.repeat(forcing[starts][:, None], length, axis=1)
    rollouts = integrate(q0, v0, frozen, held.clock.steps_s(starts, length))
    bound = config.divergence_factor * held.reach
    windows = []
    for start, states in zip(starts.tolist(), rollouts, strict=True):
        encoded = _measure(held, start, held.encoded[start : start + length], config)
        diverged = bool(has_diverged(states, bound).any())
        lost = FreeMotion(states, Peak(None, None, None), ())
        rollout = lost if diverged else _measure(held, start, states, config)
        windows.append(FreeWindow(start, encoded, rollout, diverged))
    return windows


def _measure(held: EvaluationSeries, start: int, states: np.ndarray, config: EvaluateConfig) -> FreeMotion:
    even = resample_evenly(states, held.clock, start=start)
    return FreeMotion(states, _peak(held, even, config), _modes(held, even, config))


def _peak(held: EvaluationSeries, even: np.ndarray, config: EvaluateConfig) -> Peak:
    return find_spectral_peak(even, dt_s=held.dt_s, metric=held.metric, min_cycles=config.window_min_cycles)


def _modes(held: EvaluationSeries, even: np.ndarray, config: EvaluateConfig) -> tuple[Mode, ...]:
    return fit_modes(even, dt_s=held.dt_s, metric=held.metric, most=config.decay_modes)


def compare_decay(windows: Sequence[FreeWindow], reason: str) -> dict[str, Any]:
    """Decay rates [1/s] of the strongest fitted oscillation of each window, encoded and rolled out.

    ``value`` is the relative error of the rollout's rate, the median over windows in which both have a
    decaying oscillation; ``windows`` lists them with one-sigma uncertainties and all fitted modes, and
    ``missing`` counts those whose rollout has none. None with a ``reason`` if no window has both.
    """
    rows: list[dict[str, Any]] = []
    for window in windows:
        row: dict[str, Any] = {"start": window.start, "frames": len(window.encoded.states)}
        sides = {"encoded": window.encoded.modes, "rollout": window.rollout.modes}
        row |= {name: modes[0]._asdict() if modes else None for name, modes in sides.items()}
        row |= {f"{name}_modes": [mode._asdict() for mode in modes] for name, modes in sides.items()}
        rows.append(row)
    oscillating = [row for row in rows if row["encoded"] is not None]
    both = [row for row in oscillating if row["rollout"] and row["encoded"]["rate_per_s"] > 0]
    counts = {"missing": len(oscillating) - len(both), "n_windows": len(both)}
    result: dict[str, Any] = {"windows": rows, **counts}
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


def compute_linear_modes(lagrangian: Lagrangian) -> list[dict[str, float]]:
    """Modes of the learned law linearised about its equilibrium without inputs, slowest first.

    An overdamped direction appears as two entries of frequency 0. A law without an equilibrium has none.
    """
    try:
        modes = linearize_modes(lagrangian)
    except NoEquilibriumError:
        return []
    return [
        {"frequency_hz": frequency_hz, "rate_per_s": rate_per_s}
        for frequency_hz, rate_per_s in zip(modes.frequency_hz, modes.decay_per_s, strict=True)
    ]


def compare_frequency(windows: Sequence[FreeWindow], reason: str, *, dt_s: float) -> dict[str, Any]:
    """Relative frequency error of the rollouts, with every window listed.

    ``value`` is the mean over windows of ``|f_rollout - f_encoded| / f_encoded`` by the spectral peak of the
    most visible mode. A window counts if the encoded frequency is resolved (uncertainty below a tenth of
    it); if none is, the damped fit is used, and ``estimator`` names the one in use. A rollout that diverges
    or does not oscillate counts as an error of 1. ``low`` and ``high`` are two standard errors: over windows
    if there are several, else of the single window's two estimates; ``note`` marks that case. Without any
    usable window ``value`` is None and ``reason`` says why.

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


def measure_natural_period(frequency: dict[str, Any], config: EvaluateConfig) -> float | None:
    """The natural period [s], imposed or measured by `compare_frequency`; None without either."""
    measured = frequency["encoded_hz"]
    return config.period_s or (1.0 / measured if measured else None)


def _row(window: FreeWindow, dt_s: float) -> dict[str, Any]:
    frames = len(window.encoded.states)
    row: dict[str, Any] = {"start": window.start, "frames": frames, "seconds": frames * dt_s}
    row["diverged"] = window.diverged
    for name, motion in (("encoded", window.encoded), ("rollout", window.rollout)):
        peak, modes = motion.peak, motion.modes
        row[name] = {
            SPECTRAL: [peak.visible_hz, peak.uncertainty_hz],
            WEIGHTED: [peak.weighted_hz, peak.uncertainty_hz],
            FITTED: [modes[0].frequency_hz, modes[0].frequency_sigma] if modes else [None, None],
        }
    return row


def _score(rows: Sequence[dict[str, Any]], estimator: str) -> dict[str, Any] | None:
    """Mean error of one estimator over the windows whose encoded frequency it resolves."""
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
