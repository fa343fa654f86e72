"""Jitter moves all coordinates at once along their speed; what only grows with speed is not jitter."""

import numpy as np
import pytest

from lagsplat.diagnose.effects.measurement.time_jitter import EFFECT

STD = 0.03  # of a frame


def noisy(d: int, *, shared: bool) -> tuple[np.ndarray, np.ndarray]:
    """Residuals (n, d) in units of the noise, and speeds a frame, whose instants are off by `STD`."""
    rng = np.random.default_rng(d)
    speed = 30.0 * np.sin(np.arange(2000)[:, None] * np.linspace(0.1, 0.17, d))
    late = STD * rng.standard_normal((len(speed), 1 if shared else d))
    return rng.standard_normal(speed.shape) - late * speed, speed


@pytest.mark.parametrize("d", [1, 2, 4])
def test_jitter_is_found_with_its_size(d: int) -> None:
    gain, parameters, misfit = EFFECT.explain(*noisy(d, shared=True))
    assert gain > 30.0
    assert parameters["std"][0] == pytest.approx(STD, rel=0.15)
    assert misfit == pytest.approx(2000 * d, rel=0.1)


@pytest.mark.parametrize("d", [2, 4])
def test_errors_that_grow_with_the_speed_of_each_coordinate_are_none(d: int) -> None:
    assert EFFECT.explain(*noisy(d, shared=False))[0] == 0.0


def test_even_noise_is_none() -> None:
    rng = np.random.default_rng(0)
    assert EFFECT.explain(rng.standard_normal((2000, 3)), noisy(3, shared=True)[1])[0] < 3.0
