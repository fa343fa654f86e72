"""Units of parameters follow the recorded motion."""

import pytest

from lagsplat.diagnose.effects.parameters import Scales


@pytest.mark.parametrize(("velocity", "expected"), [(20.0, 400.0), (0.5, 100.0)])
def test_a_force_is_as_large_as_inertia_or_the_spring(velocity: float, expected: float) -> None:
    scales = Scales(
        coordinate=1.0, velocity=velocity, reach=2.0, frame_s=0.01, duration_s=10.0, stiffness=100.0
    )
    assert scales.of("acceleration") == pytest.approx(expected)
