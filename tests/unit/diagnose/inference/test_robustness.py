"""A verdict that other noise would change is fragile, and one that it would not is not."""

import math
from dataclasses import replace

import numpy as np

from lagsplat.diagnose.core.result import Diagnosis
from lagsplat.diagnose.diagnosis import diagnose
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.diagnose.identification.estimated_simulator import EstimatedSimulator
from tests.unit.diagnose.toys import film, oscillator, own, settings, wave


def told(friction: float) -> Diagnosis:
    """The diagnosis of dry friction of so large an acceleration, in noise of a few per cent."""

    def law(t: float, q: float, v: float, u: float, z: np.ndarray) -> tuple[float, list[float]]:
        return own(q, v, u) - friction * math.tanh(v / 0.02), []

    known = ("input_gain", "coulomb_friction", "constant_force")
    config = replace(settings(), without=sorted(set(catalogue()) - set(known)), always_fitted=[])
    real = film(law, u=wave(2), noise=0.03, seconds=8.0)
    return diagnose(EstimatedSimulator.exact(oscillator()), [real], config).diagnosis


def kept(found: Diagnosis) -> int:
    """Repeats that answer as the verdict does."""
    return sum(name == found.candidates[0].name for name in found.checks["answers"].values())


def test_a_clear_effect_is_named_whatever_the_noise_is_taken_for() -> None:
    clear = told(2.0)
    assert clear.candidates[0].name == "coulomb_friction"
    assert (kept(clear), clear.checks["fragile"]) == (5, False)


def test_an_effect_at_the_edge_of_the_noise_is_fragile() -> None:
    edge = told(0.085)
    assert (kept(edge), edge.checks["fragile"]) == (3, True)
    assert edge.checks["answers"]["half the noise"] == "coulomb_friction"
    assert edge.checks["answers"]["twice the noise"] == "none"
