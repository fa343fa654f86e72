"""Under what conditions a recording is made, and what its sensor makes of the coordinates."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

Array = NDArray[np.float64]
WHITE, COLOURED, QUANTISED = "white", "coloured", "quantised"
# white noise before the rounding, as a share of the step, and the deviation of both together
DITHER = 0.2
QUANTISED_NOISE = float(np.hypot(1.0 / np.sqrt(12.0), DITHER))


@dataclass(frozen=True)
class Sensor:
    """How coordinates are measured.

    ``kind`` is white, coloured or quantised, ``correlation`` the noise's correlation time [samples], ``lost``
    the share of rows missing from a file, in runs of up to ``longest`` rows.
    """

    kind: str = WHITE
    correlation: float = 0.0
    lost: float = 0.0
    longest: int = 1


@dataclass(frozen=True)
class Conditions:
    """Wide conditions of a recording, laid down before anything is drawn.

    ``rate_hz`` [Hz] is raised to twelve samples in the shortest natural period. ``ratios`` are the gaps over
    the floor that the effects are sized to, ``tolerance`` that of the nominal parameters alone, 1 where they
    are exact. ``sine`` is whether the inputs are of one frequency, ``controlled`` whether they are position
    targets. ``discrepancy`` is the gap over the floor of a further law that neither the nominal equations nor
    a catalogue hold, 1 where there is none.
    """

    rate_hz: float
    sensor: Sensor
    ratios: tuple[float, ...]
    tolerance: float
    sine: bool
    controlled: bool = False
    discrepancy: float = 1.0


def noisy(ys: list[Array], sigma: Array, rng: np.random.Generator) -> list[Array]:
    """Samples with independent Gaussian noise of deviation ``sigma`` (d,)."""
    return [y + sigma * rng.standard_normal(y.shape) for y in ys]


def coloured_noise(n: int, d: int, correlation: float, rng: np.random.Generator) -> Array:
    """Gaussian noise (n, d) of unit deviation, its correlation falling to 1/e in ``correlation`` samples."""
    rho = np.exp(-1.0 / correlation)
    fresh = rng.standard_normal((n, d))
    fresh[1:] *= np.sqrt(1.0 - rho**2)
    return lfilter([1.0], [1.0, -rho], fresh, axis=0)


def quantisation_step(sigma: Array) -> Array:
    """Step (d,) of a quantised sensor whose error has the deviation ``sigma`` (d,)."""
    return sigma / QUANTISED_NOISE


def measured(ys: list[Array], sigma: Array, sensor: Sensor, rng: np.random.Generator) -> list[Array]:
    """Samples (n, d) per clip as a sensor gives them whose error has the deviation ``sigma`` (d,)."""
    if sensor.kind == COLOURED:
        return [y + sigma * coloured_noise(*y.shape, sensor.correlation, rng) for y in ys]
    if sensor.kind == QUANTISED:
        step = quantisation_step(sigma)
        return [step * np.rint(y / step) for y in noisy(ys, DITHER * step, rng)]
    return noisy(ys, sigma, rng)


def kept_rows(n: int, sensor: Sensor, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Which of ``n`` rows are in the file, (n,); the ends always are."""
    keep = np.ones(n, bool)
    wanted = round(sensor.lost * n)
    while n - keep.sum() < wanted:
        long = int(rng.integers(1, sensor.longest + 1))
        long = min(long, wanted - int(n - keep.sum()))
        at = int(rng.integers(1, max(n - long, 2)))
        keep[at : min(at + long, n - 1)] = False
    return keep
