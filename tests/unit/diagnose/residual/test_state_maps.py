"""State regions against residuals that act at known positions and velocities."""

import numpy as np

from lagsplat.diagnose.residual.state_maps import find_state_regions
from tests.unit.diagnose.residuals import made, no_force


def test_a_wall_has_its_region():
    found, maps = find_state_regions(
        [made(lambda t, q, v, u: -8.0 * np.maximum(q - 0.8, 0.0), 60.0)], period_s=1.0
    )
    profile = next(one for one in found if one.velocity is None)
    assert profile.share > 0.5
    assert 0.3 < profile.position[0] < 0.95
    assert profile.mean < 0.0
    assert {len(one.velocity_edges) for one in maps} == {2, 9}


def test_friction_has_a_region_on_either_side_of_rest():
    found, _ = find_state_regions([made(lambda t, q, v, u: -np.tanh(v / 0.1), 40.0)], period_s=1.0)
    boxes = [one for one in found if one.velocity is not None]
    assert {np.sign(one.mean) for one in boxes} == {-1.0, 1.0}
    for one in boxes:
        assert np.sign(np.mean(one.velocity)) == -np.sign(one.mean)
    assert sum(one.share for one in boxes) > 0.5


def test_regions_of_noise_are_rare_and_few_blocks_say_nothing():
    told = sum(
        bool(find_state_regions([made(no_force, seed=seed)], period_s=1.0, seed=seed)[0])
        for seed in range(60)
    )
    assert told <= 7
    assert find_state_regions([made(lambda t, q, v, u: 3.0 + 0.0 * q, 3.0)], period_s=1.0)[0] == []
