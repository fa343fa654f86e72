"""Frequencies at which the residual acts: multitaper spectra, lines, coherence with motion and inputs.

Clips are resampled to even steps, tapered by Slepian sequences of their own length, and averaged by length.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex, Float64
from scipy.interpolate import CubicSpline
from scipy.ndimage import maximum_filter1d
from scipy.signal.windows import dpss
from scipy.stats import f as fisher
from scipy.stats import false_discovery_control

from lagsplat.diagnose.core.config import SPECTRUM
from lagsplat.diagnose.residual.latent_force import LatentForceEstimate, compute_rms_acceleration


@dataclass(frozen=True)
class SpectralLine:
    """A sinusoid in a coordinate's residual."""

    frequency_hz: float
    coordinate: int
    p: float  # chance of as clear a sinusoid in noise


@dataclass(frozen=True)
class ResidualSpectrum:
    """Spectra of the residual."""

    frequency_hz: np.ndarray  # (F,)
    power: np.ndarray  # (F, d) over the coordinate's rms acceleration [1/Hz]; zero where no force was kept
    coherence: np.ndarray  # (F, d, m) squared, with each of `names`
    names: tuple[str, ...]  # of the inputs, then of the velocities
    significant: float  # coherence that noise exceeds in 1 of 100
    bands: tuple[tuple[float, float, float], ...]  # low [Hz], high [Hz], share of the power
    lines: tuple[SpectralLine, ...]


@dataclass(frozen=True)
class _TaperedClip:
    """One clip under ``K`` tapers."""

    transform: Complex[np.ndarray, "F K channels"]
    sums: Float64[np.ndarray, " K"]  # of each taper
    seconds: float


def compute_spectrum(estimates: Sequence[LatentForceEstimate], *, period_s: float) -> ResidualSpectrum | None:
    """Compute the spectrum of the residuals of all motions.

    ``period_s`` is the natural period [s]. None where no clip lasts `SPECTRUM.min_clip_periods` of it.

    Source: Thomson (1982), spectrum estimation and harmonic analysis, for the tapers and the test of lines.
    """
    d, n_u = estimates[0].motion.d, estimates[0].motion.n_u
    unit = compute_rms_acceleration(estimates)
    active = estimates[0].active
    dt_s = max(estimate.motion.dt_s for estimate in estimates)
    resampled = _resample_clips(estimates, unit, period_s, dt_s)
    if not resampled:
        return None
    size = 2 ** int(np.ceil(np.log2(SPECTRUM.padding * max(len(values) for values in resampled))))
    frequency = np.fft.rfftfreq(size, dt_s)
    kept = (frequency > 0.0) & (frequency <= min(SPECTRUM.max_frequency_ratio / period_s, 0.4 / dt_s))
    clips = [_taper_clip(values, dt_s, size, kept) for values in resampled]
    weight = SPECTRUM.tapers * np.array([clip.seconds for clip in clips]).sum()
    weighted = [(clip.seconds, clip.transform) for clip in clips]
    auto = sum(s * np.sum(np.abs(z) ** 2, axis=1) for s, z in weighted) / weight
    cross = sum(s * np.einsum("fkr,fkz->frz", z[..., :d].conj(), z) for s, z in weighted) / weight
    power = np.where(active, auto[:, :d], 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        coherence = np.abs(cross[..., d:]) ** 2 / (auto[:, :d, None] * auto[:, None, d:])
    # Where the residual has no power, leakage from stronger frequencies would look coherent.
    loud = power > SPECTRUM.min_relative_power * power.max(axis=0)
    coherence = np.where(loud[..., None], np.nan_to_num(coherence), 0.0)
    first = estimates[0].motion
    return ResidualSpectrum(
        frequency_hz=frequency[kept],
        power=power,
        coherence=coherence,
        names=(*first.u_names[:n_u], *(f"v_{name}" for name in first.q_names)),
        significant=1.0 - 0.01 ** (1.0 / (SPECTRUM.tapers * len(clips) - 1)),
        bands=_find_bands(frequency[kept], power.sum(axis=1)),
        lines=_find_lines(clips, frequency[kept], active),
    )


def _resample_clips(
    estimates: Sequence[LatentForceEstimate], unit: np.ndarray, period_s: float, dt_s: float
) -> list[Float64[np.ndarray, "N channels"]]:
    """Residual, inputs and velocities of each clip that is long enough, at even steps of ``dt_s`` [s]."""
    clips = []
    for estimate in estimates:
        channels = np.concatenate([estimate.residual / unit, estimate.motion.u, estimate.v], axis=1)
        for start, stop in estimate.motion.segments:
            time_s = estimate.motion.time_s[start:stop]
            duration_s = time_s[-1] - time_s[0]
            if duration_s < SPECTRUM.min_clip_periods * period_s or stop - start < 8 * SPECTRUM.tapers:
                continue
            even = time_s[0] + dt_s * np.arange(int(duration_s / dt_s + 1e-6) + 1)
            clips.append(CubicSpline(time_s, channels[start:stop])(np.minimum(even, time_s[-1])))
    return clips


def _taper_clip(values: np.ndarray, dt_s: float, size: int, kept: np.ndarray) -> _TaperedClip:
    """Transform a clip under each taper, at the frequencies in ``kept``."""
    tapers = dpss(len(values), SPECTRUM.half_bandwidth, SPECTRUM.tapers)  # (K, N)
    centred = values - values.mean(axis=0)
    transform = np.fft.rfft(centred[:, None, :] * tapers.T[:, :, None], size, axis=0)[kept]
    root = np.sqrt(dt_s)
    return _TaperedClip(root * transform, root * tapers.sum(axis=1), dt_s * len(values))


def _find_lines(
    clips: list[_TaperedClip], frequency: np.ndarray, active: np.ndarray
) -> tuple[SpectralLine, ...]:
    """Sinusoids by the F test, at most one in a bandwidth, under a bounded false discovery rate."""
    lines = []
    longest = max(clip.seconds for clip in clips)
    apart = max(1, round(1.0 / longest / (frequency[1] - frequency[0])))
    for i in np.flatnonzero(active):
        above, below = np.zeros(len(frequency)), np.zeros(len(frequency))
        for clip in clips:
            y, h = clip.transform[..., i], clip.sums
            amplitude = y @ h / (h @ h)
            above += np.abs(amplitude) ** 2 * (h @ h)
            below += np.sum(np.abs(y - amplitude[:, None] * h) ** 2, axis=1)
        freedom = 2 * len(clips) * (SPECTRUM.tapers - 1)
        ratio = (above / (2 * len(clips))) / np.maximum(below / freedom, np.finfo(float).tiny)
        p = fisher.sf(ratio, 2 * len(clips), freedom)
        around = maximum_filter1d(ratio, 2 * apart + 1, mode="constant", cval=-np.inf)
        peaks = np.flatnonzero(ratio >= around)
        # The p of a peak is the smallest of some three independent ones around it.
        q = false_discovery_control(np.minimum(1.0, 3.0 * p[peaks])) if len(peaks) else []
        lines += [
            SpectralLine(float(frequency[at]), int(i), float(p[at]))
            for at, rate in zip(peaks, q, strict=True)
            if rate < SPECTRUM.line_false_alarm_rate
        ]
    return tuple(sorted(lines, key=lambda line: line.p))


def _find_bands(frequency: np.ndarray, power: np.ndarray) -> tuple[tuple[float, float, float], ...]:
    """Peaks of the power with their surroundings, largest share first."""
    total = power.sum()
    left = power.copy()
    bands: list[tuple[float, float, float]] = []
    while total > 0.0 and len(bands) < SPECTRUM.max_bands:
        peak = int(np.argmax(left))
        level = SPECTRUM.band_edge_share * left[peak]
        if left[peak] <= 0.0:
            break
        low = peak - int(np.argmax(np.append(left[peak::-1] < level, True))) + 1
        high = peak + int(np.argmax(np.append(left[peak:] < level, True))) - 1
        share = float(left[low : high + 1].sum() / total)
        if share < SPECTRUM.min_band_share:
            break
        bands.append((float(frequency[low]), float(frequency[high]), share))
        left[low : high + 1] = 0.0
    return tuple(sorted(bands, key=lambda band: -band[2]))
