"""Chamber pressures: rest, a band-limited random drive, a held pose, and the release into free decay."""

import numpy as np
from jaxtyping import Float64
from scipy.interpolate import CubicSpline

from lagsplat.systems.config import SimulationConfig

RELEASE_FRAMES = 8


def random_band(
    n_frames: int,
    n_inputs: int,
    *,
    dt_s: float,
    low_hz: float,
    high_hz: float,
    generator: np.random.Generator,
) -> Float64[np.ndarray, "n_frames n_inputs"]:
    """Independent Gaussian signals of unit variance, zero outside the band, amplitude falling as 1/f inside.

    The period is at least four of the lowest frequency, so that a short record still has a continuous-looking
    spectrum; the record is a part of it.
    """
    period = max(n_frames, int(np.ceil(4 / (low_hz * dt_s))))
    frequency = np.fft.rfftfreq(period, dt_s)
    inside = (frequency >= low_hz) & (frequency <= high_hz)
    amplitude = np.where(inside, 1 / np.where(inside, frequency, 1.0), 0.0)
    shape = (frequency.size, n_inputs)
    spectrum = generator.standard_normal(shape) + 1j * generator.standard_normal(shape)
    spectrum *= amplitude[:, None] * period / (2 * np.sqrt(np.sum(amplitude**2)))
    return np.fft.irfft(spectrum, n=period, axis=0)[:n_frames]


def _smooth_step(n_frames: int, *, start: int, length: int) -> Float64[np.ndarray, " n_frames"]:
    """0 up to ``start``, 1 from ``start + length``, twice continuously differentiable between."""
    x = np.clip((np.arange(n_frames) - start) / length, 0.0, 1.0)
    return x**3 * (10 - 15 * x + 6 * x**2)


def draw_pressures(
    config: SimulationConfig, *, generator: np.random.Generator
) -> Float64[np.ndarray, "n_frames n_inputs"]:
    """The true pressures at the frames [atm], one column a chamber.

    Zero for ``rest_frames``; a smooth start over ``hold_frames``; the drive ``max (1 + tanh(0.6 x)) / 2``,
    which keeps 90 % of the samples within 0.12-0.88 of the maximum; a blend into ``hold_atm`` over
    ``hold_frames``; released within eight frames from frame ``n_frames - tail_frames`` on.
    """
    n, release = config.n_frames, config.n_frames - config.tail_frames
    signal = random_band(
        n, len(config.hold_atm), dt_s=config.dt_s, low_hz=config.drive_low_hz, high_hz=config.drive_high_hz,
        generator=generator,
    )  # fmt: skip
    drive = 0.5 * config.drive_max_atm * (1 + np.tanh(0.6 * signal))
    start = _smooth_step(n, start=config.rest_frames, length=config.hold_frames)
    hold = _smooth_step(n, start=release - config.hold_frames, length=config.hold_frames)
    end = _smooth_step(n, start=release, length=RELEASE_FRAMES)
    blended = drive * (1 - hold)[:, None] + np.asarray(config.hold_atm) * hold[:, None]
    return blended * (start * (1 - end))[:, None]


def spline_coefficients(
    pressures: Float64[np.ndarray, "n_frames n_inputs"], *, dt_s: float
) -> Float64[np.ndarray, "4 n_intervals n_inputs"]:
    """Cubic spline through the frames: the smooth function of time the arm feels, powers from 3 down to 0."""
    return np.ascontiguousarray(CubicSpline(np.arange(len(pressures)) * dt_s, pressures, bc_type="natural").c)
