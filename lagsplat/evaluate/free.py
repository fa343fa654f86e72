"""Free motion: where the inputs stand still, cut into windows, with the rollout of each window beside it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.latent import squared_norm
from lagsplat.evaluate.modes import Mode, fit_modes
from lagsplat.evaluate.protocol import HeldOut, Integrate, beyond, initial_states
from lagsplat.evaluate.resample import evenly_spaced
from lagsplat.evaluate.spectrum import Peak, spectral_peak

LEAST_WINDOW = 16


@dataclass(frozen=True)
class FreeWindow:
    """One stretch of free motion as encoded and as rolled out from its first state under frozen inputs."""

    start: int
    encoded: Float64[np.ndarray, "N d"]
    simulated: Float64[np.ndarray, "N d"]
    encoded_peak: Peak
    simulated_peak: Peak
    encoded_modes: tuple[Mode, ...]
    simulated_modes: tuple[Mode, ...]
    diverged: bool


def free_segments(held: HeldOut, config: EvaluateConfig) -> list[tuple[int, int]]:
    """Half-open stretches over which no input moves, longest first.

    On the measured inputs after the skip, never across clips: every change from frame to frame below
    ``free_rate_fraction`` of the largest peak-to-peak amplitude, total excursion below
    ``free_excursion_fraction`` of it, at least ``free_min_s`` long. Without inputs, or with constant ones,
    every clip is free.
    """
    least = max(round(config.free_min_s / held.dt_s), 1)
    scored = held.inputs[held.skip :]
    amplitude = float(np.ptp(scored, axis=0).max()) if held.inputs.shape[1] else 0.0
    found: list[tuple[int, int]] = []
    for clip in held.clips:
        if clip[1] - clip[0] < least:
            continue
        if amplitude == 0.0:
            found.append(clip)
            continue
        rate, excursion = config.free_rate_fraction * amplitude, config.free_excursion_fraction * amplitude
        found += [
            (clip[0] + a, clip[0] + b)
            for a, b in _still(held.inputs[slice(*clip)], rate, excursion)
            if b - a >= least
        ]
    return sorted(found, key=lambda ends: ends[0] - ends[1])[: config.free_max_segments]


def _still(inputs: np.ndarray, rate: float, excursion: float) -> list[tuple[int, int]]:
    """Runs of slow frames, each cut anew where its excursion would exceed the limit."""
    slow = np.abs(np.diff(inputs, axis=0)).max(axis=1) < rate
    runs, start = [], 0
    low = high = inputs[0]
    for frame in range(1, len(inputs)):
        low, high = np.minimum(low, inputs[frame]), np.maximum(high, inputs[frame])
        if not slow[frame - 1] or (high - low).max() >= excursion:
            runs.append((start, frame))
            start, low, high = frame, inputs[frame], inputs[frame]
    return [*runs, (start, len(inputs))]


def free_windows(held: HeldOut, integrate: Integrate, config: EvaluateConfig) -> tuple[list[FreeWindow], str]:
    """Every usable window of free motion, and a sentence saying why there is none (empty otherwise).

    A window lasts ``window_cycles`` cycles of its segment's own frequency, at least sixteen frames and at
    most the segment; windows tile it. A segment whose spectrum shows no peak takes that of its strongest
    fitted oscillation. Windows whose RMS motion is below ``window_min_amplitude`` of the clip's are left out:
    they show the encoder's jitter. The estimators of frequency and decay need even spacing: on an uneven
    clock they see each window resampled by `evenly_spaced`, the encoded and the rolled-out one alike.
    """
    segments = free_segments(held, config)
    if not segments:
        return (
            [],
            f"no input stands still for {config.free_min_s} s after the first {held.skip} held-out frames",
        )
    scale = _rms(held.encoded, held.metric)
    kept: list[FreeWindow] = []
    for start, stop in segments:
        frequency = _segment_frequency(_even(held.encoded[start:stop], held, start), held, config)
        if frequency is None:
            continue
        length = min(max(round(config.window_cycles / (frequency * held.dt_s)), LEAST_WINDOW), stop - start)
        starts = np.arange(start, stop - length + 1, length)
        loud = [
            s
            for s in starts
            if _rms(held.encoded[s : s + length], held.metric) >= config.window_min_amplitude * scale
        ]
        if loud:
            kept += _roll_out(held, integrate, np.array(loud), length, config)
    if kept:
        return sorted(kept, key=lambda window: window.start), ""
    return [], f"{len(segments)} free segment(s), none with an oscillation above the quietest one allowed"


def _rms(series: np.ndarray, metric: np.ndarray) -> float:
    return float(np.sqrt(squared_norm(series - series.mean(axis=0), metric).mean()))


def _segment_frequency(series: np.ndarray, held: HeldOut, config: EvaluateConfig) -> float | None:
    peak = _peak(series, held, config).visible_hz
    if peak is not None:
        return peak
    modes = _modes(series, held, config)
    return modes[0].frequency_hz if modes else None


def _roll_out(
    held: HeldOut, integrate: Integrate, starts: np.ndarray, length: int, config: EvaluateConfig
) -> list[FreeWindow]:
    # A window may end with the clip: its velocity stencil then still has its three frames inside it.
    q0, v0 = initial_states(held, starts)
    forcing = held.forcing if held.standing is None else held.standing
    frozen = np.repeat(forcing[starts][:, None], length, axis=1)
    rollouts = integrate(q0, v0, frozen, held.clock.steps_s(starts, length))
    bound = config.divergence_factor * held.reach
    kept = []
    for start, simulated in zip(starts.tolist(), rollouts, strict=True):
        encoded = held.encoded[start : start + length]
        diverged = bool(beyond(simulated, bound).any())
        seen = _even(encoded, held, start)
        said = simulated if diverged else _even(simulated, held, start)
        kept.append(
            FreeWindow(
                start=start,
                encoded=encoded,
                simulated=simulated,
                encoded_peak=_peak(seen, held, config),
                simulated_peak=Peak(None, None, None) if diverged else _peak(said, held, config),
                encoded_modes=_modes(seen, held, config),
                simulated_modes=() if diverged else _modes(said, held, config),
                diverged=diverged,
            )
        )
    return kept


def _even(series: np.ndarray, held: HeldOut, start: int) -> np.ndarray:
    return evenly_spaced(series, held.clock, start=start)


def _peak(series: np.ndarray, held: HeldOut, config: EvaluateConfig) -> Peak:
    return spectral_peak(series, dt_s=held.dt_s, metric=held.metric, min_cycles=config.window_min_cycles)


def _modes(series: np.ndarray, held: HeldOut, config: EvaluateConfig) -> tuple[Mode, ...]:
    return fit_modes(series, dt_s=held.dt_s, metric=held.metric, most=config.decay_modes)
