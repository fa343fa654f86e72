"""A real motion that goes further than the sim's recordings: what the sim cannot know is no effect."""

from dataclasses import replace

import numpy as np
import pytest

from lagsplat.diagnose.core.result import Diagnosis
from lagsplat.diagnose.diagnosis import diagnose
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.diagnose.identification.estimated_simulator import estimate_simulator
from lagsplat.io.trajectory.trajectory import Trajectory
from tests.unit.diagnose.toys import film, settings, wave

KNOWN = ("constant_force", "viscous_damping", "input_gain", "end_stop", "cubic_stiffness")


def pendulum(seed: int, push: float, *, seconds: float, rate: float, noise: float) -> Trajectory:
    """A driven pendulum of 0.7 Hz with a further acceleration ``push`` and damping ``rate`` [1/s]."""
    return film(
        lambda t, q, v, u, z: (-19.6 * np.sin(q) - rate * v + 5.0 * u + push, []),
        u=wave(seed),
        start=(0.0, 0.0),
        seconds=seconds,
        noise=noise,
    )


def compared(real: Trajectory) -> Diagnosis:
    """A real motion beside a sim that is known by 20 s without noise."""
    config = replace(settings(), without=sorted(set(catalogue()) - set(KNOWN)), always_fitted=[])
    nominal = pendulum(1, 0.0, seconds=20.0, rate=1.2, noise=0.0)
    return diagnose(estimate_simulator([nominal], config), [real], config).diagnosis


def test_two_sims_that_agree_to_a_thousandth_have_no_gap() -> None:
    """Neither side has noise: what the law that was found has wrong is seen, and is nothing."""
    found = compared(pendulum(3, 0.0, seconds=15.0, rate=1.2, noise=0.0))
    assert found.verdict == "none"
    assert found.gap is not None
    assert found.gap.before < 0.003


@pytest.mark.parametrize(("push", "name"), [(4.0, "constant_force"), (0.0, "none")])
def test_what_lies_beyond_the_sims_recordings_is_no_effect(push: float, name: str) -> None:
    found = compared(pendulum(2, push, seconds=15.0, rate=1.2, noise=0.01))
    assert found.candidates[0].name == name
    assert found.combination == ((name,) if push else ())
