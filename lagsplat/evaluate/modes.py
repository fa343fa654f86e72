"""Fit damped oscillations to a free motion: frequency and decay rate, even where a spectrum has no peak.

A strongly damped motion lasts about a cycle and its spectrum peaks at zero frequency; a sum of damped
sinusoids still fits it. Poles come from the shift invariance of the series' signal subspace (ESPRIT), are
refined by least squares with the amplitudes projected out, and the BIC chooses their number.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex128, Float64
from scipy.optimize import least_squares

HANKEL_ROWS = 120
SAMPLES = 600


class Mode(NamedTuple):
    """One damped oscillation ``exp(-rate t) cos(2 pi f t + phase)``, with one-sigma uncertainties [Hz, 1/s].

    ``share`` is its part of the oscillations' summed energy in the metric over the window.
    """

    frequency_hz: float
    frequency_sigma: float
    rate_per_s: float
    rate_sigma: float
    share: float


def fit_modes(
    series: Float64[np.ndarray, "N d"],
    *,
    dt_s: float,
    metric: Float64[np.ndarray, "d d"],
    most: int,
) -> tuple[Mode, ...]:
    """Damped oscillations of a free motion about a constant, strongest first; may be empty.

    Non-oscillating relaxations are fitted but not returned, nor are oscillations of less than half a cycle
    over the window or damped within a third of a cycle. The covariance is that of least squares, with the
    residual's spectral level in the fitted band as noise, so that smoothed jitter does not count as many
    independent samples.

    Args:
        series, dt_s: states, evenly spaced (see `resample_evenly`), and their spacing [s].
        metric, most: weight of the coordinates, and maximum number of oscillations.

    Source: DOI 10.1109/29.32276 (ESPRIT); DOI 10.1137/0710036 (variable projection).
    """
    stride = max(1, len(series) // SAMPLES)
    sampled = series[::stride] @ root_of_metric(metric)
    step_s = dt_s * stride
    scale = np.abs(sampled - sampled.mean(axis=0)).max()
    if len(sampled) < 12 or not np.isfinite(scale) or scale == 0.0:
        return ()
    signal = (sampled - sampled.mean(axis=0)) / scale
    time_s = np.arange(len(signal)) * step_s
    best = min(
        (_canonical(poles) for poles in _esprit(signal, step_s, most)),
        key=lambda poles: _bic(poles, signal, time_s),
        default=np.zeros(0, dtype=complex),
    )
    if not np.any(best.imag > 0):
        return ()
    poles, sigma = _refine(best, signal, time_s)
    return _oscillations(poles, sigma, signal, time_s)


def root_of_metric(metric: Float64[np.ndarray, "d d"]) -> Float64[np.ndarray, "d d"]:
    """A matrix ``R`` with ``R R^T = metric``: distances of states times ``R`` are those in the metric."""
    values, vectors = np.linalg.eigh(metric)
    return vectors * np.sqrt(np.clip(values, 0.0, None))


def _esprit(signal: np.ndarray, step_s: float, most: int) -> list[Complex128[np.ndarray, " p"]]:
    """Continuous-time poles for every model order up to ``most`` oscillations and two relaxations."""
    rows = min(len(signal) // 2, HANKEL_ROWS)
    hankel = np.lib.stride_tricks.sliding_window_view(signal, rows, axis=0)
    stacked = hankel.reshape(-1, rows).T
    basis = np.linalg.eigh(stacked @ stacked.T)[1][:, ::-1]
    candidates = []
    for order in range(2, min(2 * most + 2, rows // 2) + 1):
        shift = np.linalg.lstsq(basis[:-1, :order], basis[1:, :order], rcond=None)[0]
        discrete = np.linalg.eigvals(shift).astype(complex)
        discrete = discrete[np.abs(discrete) > 1e-3]
        candidates.append(np.log(discrete) / step_s)
    return candidates


def _canonical(poles: np.ndarray) -> np.ndarray:
    """One pole of each conjugate pair (positive imaginary part), then the real poles."""
    real = poles[np.abs(poles.imag) < 1e-9].real.astype(complex)
    return np.concatenate([poles[poles.imag >= 1e-9], real])


def _columns(poles: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    parts = [np.ones_like(time_s)]
    for pole in poles:
        # a growing pole is written backwards from the window's end: the same span, no overflow
        origin = time_s[-1] if pole.real > 0 else 0.0
        wave = np.exp(pole * (time_s - origin))
        parts += [wave.real] if pole.imag == 0 else [wave.real, wave.imag]
    return np.stack(parts, axis=1)


def _residual(poles: np.ndarray, signal: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    basis = np.linalg.qr(_columns(poles, time_s))[0]
    return signal - basis @ (basis.T @ signal)


def _bic(poles: np.ndarray, signal: np.ndarray, time_s: np.ndarray) -> float:
    free = poles.size + int(np.sum(poles.imag > 0))
    amplitudes = (1 + free) * signal.shape[1]
    error = np.mean(_residual(poles, signal, time_s) ** 2)
    return float(signal.size * np.log(error + 1e-12) + (free + amplitudes) * np.log(signal.size))


def _refine(poles: np.ndarray, signal: np.ndarray, time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Least-squares poles and the one-sigma uncertainties (of rate, of angular frequency) of each."""
    span = time_s[-1]
    turning = poles.imag > 0

    def unpack(vector: np.ndarray) -> np.ndarray:
        refined = (vector[: len(poles)] / span).astype(complex)
        refined[turning] += 1j * np.abs(vector[len(poles) :]) / span
        return refined

    def residual(vector: np.ndarray) -> np.ndarray:
        return _residual(unpack(vector), signal, time_s).ravel()

    start = np.concatenate([poles.real, poles.imag[turning]]) * span
    solved = least_squares(residual, start, method="lm", max_nfev=40 * (len(start) + 1))
    left = solved.fun.reshape(signal.shape)
    slopes = solved.jac.reshape(*signal.shape, len(start))
    # Coordinates of unequal visibility have unequal noise: each is weighted by its own residual.
    meat = np.einsum("nci,ncj,c->ij", slopes, slopes, _noise(left, len(start)))
    bread = np.linalg.pinv(solved.jac.T @ solved.jac)
    covariance = bread @ meat @ bread
    deviation = np.sqrt(np.clip(np.diag(covariance), 0.0, None)) / span
    sigma = np.full((len(poles), 2), np.nan)
    sigma[:, 0] = deviation[: len(poles)]
    sigma[turning, 1] = deviation[len(poles) :]
    return unpack(solved.x), sigma


def _noise(residual: np.ndarray, parameters: int) -> np.ndarray:
    """Noise variance of each channel at the frequencies of the motion, at least that of the residual."""
    power = np.abs(np.fft.rfft(residual, axis=0)[1:]) ** 2
    low = power[: max(len(power) // 8, 1)].mean(axis=0)
    colour = np.maximum(low / np.maximum(power.mean(axis=0), 1e-300), 1.0)
    degrees = max(len(residual) - parameters - 1, 1)
    return np.sum(residual**2, axis=0) / degrees * colour


def _oscillations(
    poles: np.ndarray, sigma: np.ndarray, signal: np.ndarray, time_s: np.ndarray
) -> tuple[Mode, ...]:
    columns = _columns(poles, time_s)
    amplitudes = np.linalg.lstsq(columns, signal, rcond=None)[0]
    turning, at = [], 1
    for pole, deviation in zip(poles, sigma, strict=True):
        width = 1 if pole.imag == 0 else 2
        part = columns[:, at : at + width] @ amplitudes[at : at + width]
        at += width
        if pole.imag * time_s[-1] >= np.pi and abs(pole.real) <= 3.0 * pole.imag / (2 * np.pi):
            turning.append((pole, deviation, float(np.sum(part**2))))
    total = sum(energy for _, _, energy in turning) or 1.0
    modes = (
        Mode(
            frequency_hz=float(pole.imag / (2 * np.pi)),
            frequency_sigma=float(deviation[1] / (2 * np.pi)),
            rate_per_s=float(-pole.real),
            rate_sigma=float(deviation[0]),
            share=energy / total,
        )
        for pole, deviation, energy in turning
    )
    return tuple(sorted(modes, key=lambda mode: -mode.share))
