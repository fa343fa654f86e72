"""Random chamber pressures: how they are drawn, how they lag, and the spline between frames."""

import numpy as np
from jaxtyping import Float64
from scipy.interpolate import CubicSpline
from scipy.signal import lsim, lti

from lagsplat.systems.config import SimulationConfig
from lagsplat.systems.dynamics import Series

RELEASE_FRAMES = 8


def draw_random_band(
    n_frames: int,
    n_inputs: int,
    band_hz: tuple[float, float],
    *,
    dt_s: float,
    generator: np.random.Generator,
) -> Series:
    """Independent Gaussian signals of unit variance, zero outside the band, amplitude falling as 1/f inside.

    The signal is a part of one with at least four periods of the lowest frequency, so that a short signal
    still has a nearly continuous spectrum.
    """
    low_hz, high_hz = band_hz
    period = max(n_frames, int(np.ceil(4 / (low_hz * dt_s))))
    frequency = np.fft.rfftfreq(period, dt_s)
    inside = (frequency >= low_hz) & (frequency <= high_hz)
    amplitude = np.where(inside, 1 / np.where(inside, frequency, 1.0), 0.0)
    shape = (frequency.size, n_inputs)
    spectrum = generator.standard_normal(shape) + 1j * generator.standard_normal(shape)
    spectrum *= amplitude[:, None] * period / (2 * np.sqrt(np.sum(amplitude**2)))
    return np.fft.irfft(spectrum, n=period, axis=0)[:n_frames]


def draw_pressures(config: SimulationConfig, *, generator: np.random.Generator) -> Series:
    """The true pressures at the frames [atm], one column per chamber.

    Zero for ``rest_frames``; a smooth start over ``hold_frames``; the drive ``max (1 + tanh(0.6 x)) / 2``,
    which keeps 90 % of the samples within 0.12-0.88 of the maximum; a blend into ``hold_atm`` over
    ``hold_frames``; released within eight frames from frame ``n_frames - tail_frames`` on.
    """
    n, release = config.n_frames, config.n_frames - config.tail_frames

    def step_up(start: int, length: int) -> Float64[np.ndarray, " n_frames"]:
        """0 up to ``start``, 1 from ``start + length``, twice continuously differentiable between."""
        x = np.clip((np.arange(n) - start) / length, 0.0, 1.0)
        return x**3 * (10 - 15 * x + 6 * x**2)

    band_hz = (config.drive_low_hz, config.drive_high_hz)
    signal = draw_random_band(n, len(config.hold_atm), band_hz, dt_s=config.dt_s, generator=generator)
    drive = 0.5 * config.drive_max_atm * (1 + np.tanh(0.6 * signal))
    start = step_up(config.rest_frames, config.hold_frames)
    hold = step_up(release - config.hold_frames, config.hold_frames)
    end = step_up(release, RELEASE_FRAMES)
    blended = drive * (1 - hold)[:, None] + np.asarray(config.hold_atm) * hold[:, None]
    return blended * (start * (1 - end))[:, None]


def spline_coefficients(pressures: Series, *, dt_s: float) -> Float64[np.ndarray, "4 n_intervals n_inputs"]:
    """Cubic spline through the pressures at the frames, as the arm receives them; powers from 3 down to 0."""
    return np.ascontiguousarray(CubicSpline(np.arange(len(pressures)) * dt_s, pressures, bc_type="natural").c)


def lag_input(pressures: Series, *, lag_s: float, dt_s: float) -> Series:
    """Pressures behind a first-order lag, exact for piecewise linear inputs; unchanged without lag."""
    if lag_s == 0.0:
        return pressures
    times = dt_s * np.arange(len(pressures))
    columns = [lsim(lti([1.0], [lag_s, 1.0]), column, times)[1] for column in pressures.T]
    return np.stack(columns, axis=1)
