"""Systems whose numbers are drawn at random."""

import numpy as np
import pytest

from benchmarks import drawn_systems
from lagsplat.config.compose import compose
from lagsplat.systems.mechanism import compute_free_modes, make_mechanism


def test_a_draw_is_repeated_and_another_differs() -> None:
    first = drawn_systems.draw_overrides(1)
    assert first == drawn_systems.draw_overrides(1)
    other = drawn_systems.draw_overrides(2)
    assert set(first) == {*drawn_systems.RELEASED, *drawn_systems.DRIVEN}
    assert all(first[system] != other[system] for system in first)


@pytest.mark.parametrize("system", drawn_systems.RELEASED)
def test_a_released_system_keeps_its_shape_and_gets_other_physics(system: str) -> None:
    before = compose(f"system={system}").release
    words = drawn_systems.draw_overrides(1)[system].split()
    after = compose(f"system={system}", *words).release
    size = after.scene.view_width / before.scene.view_width
    assert 1 / 1.4 < size < 1.4
    for old, new in zip(before.bodies, after.bodies, strict=True):
        assert new.size_m == pytest.approx([size * length for length in old.size_m], rel=1e-4)
    old, new = (compute_free_modes(make_mechanism(config)).natural_hz for config in (before, after))
    assert new / old == pytest.approx(np.full(len(old), size**-0.5), rel=1e-3)
    old, new = ([np.abs(clip.state).max() for clip in config.clips] for config in (before, after))
    ratios = np.divide(new, old)
    assert ratios == pytest.approx(ratios[0], rel=1e-4)
    assert drawn_systems.LEAST_RELEASE <= ratios[0] <= 1.0


@pytest.mark.parametrize("system", drawn_systems.DRIVEN)
def test_an_arm_stays_a_valid_simulation(system: str) -> None:
    before = compose(f"system={system}").simulation
    after = compose(f"system={system}", *drawn_systems.draw_overrides(3)[system].split()).simulation
    factor = after.arm.bending_stiffness[0] / before.arm.bending_stiffness[0]
    assert after.arm.chamber_area == pytest.approx(
        [factor * area for area in before.arm.chamber_area], rel=1e-4
    )
    assert after.drive_high_hz != before.drive_high_hz
