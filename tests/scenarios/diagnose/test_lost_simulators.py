"""A sim whose forces overflow along the real motion: it cannot be smoothed, and there are no hints."""

from dataclasses import replace

import numpy as np
import pytest

from lagsplat.diagnose.inference.placement import find_hints
from lagsplat.diagnose.residual.latent_force import estimate_latent_force
from tests.unit.diagnose.toys import film, oscillator, own, wave


def lost():
    return replace(oscillator(), potential=np.array([0.0, 0.0, 1.0, 0.0, 1e305]))


@pytest.fixture(autouse=True)
def _as_every_diagnosis_runs():
    with np.errstate(all="ignore"):
        yield


def test_it_cannot_be_smoothed() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        estimate_latent_force(lost(), [film(u=wave(3), noise=0.01, seed=3)], period_s=1.0)


def test_a_sim_that_overflows_gives_no_hints() -> None:
    real = film(u=wave(3), noise=0.01, seed=3)
    (hint,) = find_hints(lost(), [real], period_s=1.0, hold="linear")
    assert (hint.pushes, hint.lines_hz) == ((), ())
    (hint,) = find_hints(
        oscillator(),
        [film(lambda t, q, v, u, z: (own(q, v, u) + 9.0 * (5.0 < t < 5.3), []), u=wave(3))],
        period_s=1.0,
        hold="linear",
    )
    assert any(start < 5.3 and end > 5.0 for start, end in hint.pushes)
