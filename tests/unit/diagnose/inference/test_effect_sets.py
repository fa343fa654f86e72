"""Two effects at once, and one that must not be made into two."""

import math
from dataclasses import replace

import numpy as np
import pytest

from lagsplat.diagnose.core.config import DiagnoseConfig
from lagsplat.diagnose.core.result import Diagnosis
from lagsplat.diagnose.diagnosis import diagnose
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.diagnose.identification.estimated_simulator import EstimatedSimulator
from lagsplat.io.trajectory.trajectory import Trajectory
from tests.unit.diagnose.toys import film, oscillator, own, settings, wave

RIVALS = (
    "coulomb_friction",
    "cubic_stiffness",
    "input_saturation",
    "quadratic_drag",
    "input_lag",
    "constant_force",
)
U = wave(4)


def few() -> DiagnoseConfig:
    left_out = sorted(set(catalogue()) - set(RIVALS))
    return replace(settings(), without=left_out, always_fitted=[], families=5, starts=1, places=1)


def told(real: Trajectory) -> Diagnosis:
    return diagnose(EstimatedSimulator.exact(oscillator()), [real], few()).diagnosis


def test_two_planted_effects_are_both_named() -> None:
    def both(t: float, q: float, v: float, u: float, z: np.ndarray) -> tuple[float, list[float]]:
        return own(q, v, u) - 3.0 * math.tanh(v / 0.02) - 12.0 * q**3, []

    found = told(film(both, u=U, noise=0.005, seconds=16.0))
    assert found.verdict == "effect"
    assert set(found.combination) == {"coulomb_friction", "cubic_stiffness"}
    named = {one.name: one for one in found.candidates}
    assert named["coulomb_friction"].parameters["acceleration"].value == pytest.approx(3.0, rel=0.1)
    assert named["cubic_stiffness"].parameters["coefficient"].value == pytest.approx(12.0, rel=0.1)
    assert found.candidates[0].name in found.combination
    assert found.gap is not None
    assert found.gap.closure.value == pytest.approx(1.0, abs=0.03)
    assert found.checks["misfit_best"] < 1.6


def test_an_effect_of_an_input_and_one_of_the_mechanism_are_both_named() -> None:
    def sticky(t: float, q: float, v: float, u: float, z: np.ndarray) -> tuple[float, list[float]]:
        return own(q, v, u) - 0.5 * abs(v) * v, []

    found = told(film(sticky, u=lambda t: min(max(U(t), -0.8), 0.8), command=U, noise=0.005, seconds=16.0))
    assert set(found.combination) == {"quadratic_drag", "input_saturation"}


def test_one_effect_stays_one() -> None:
    def one(t: float, q: float, v: float, u: float, z: np.ndarray) -> tuple[float, list[float]]:
        return own(q, v, u) - 0.4 * abs(v) * v, []

    assert told(film(one, u=U, noise=0.01, seconds=16.0)).combination == ("quadratic_drag",)
