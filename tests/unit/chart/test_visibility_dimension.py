import numpy as np
import pytest

from lagsplat.chart.visibility import estimate_intrinsic_dimension


def test_a_surface_in_four_dimensions_has_dimension_two() -> None:
    rng = np.random.default_rng(0)
    angle = rng.uniform(0, 2 * np.pi, (3000, 2))
    torus = np.concatenate([np.cos(angle), np.sin(angle)], 1)
    got = estimate_intrinsic_dimension(torus, frames=1500, neighbours=15, seed=0)
    assert got == pytest.approx(2.0, abs=0.25)


def test_one_coordinate_is_one_and_too_few_frames_are_refused() -> None:
    assert estimate_intrinsic_dimension(np.zeros((10, 1)), frames=5, neighbours=3, seed=0) == 1.0
    with pytest.raises(ValueError, match="dimension_neighbours=20"):
        estimate_intrinsic_dimension(np.zeros((10, 2)), frames=5, neighbours=20, seed=0)


def test_repeated_frames_count_once() -> None:
    rng = np.random.default_rng(0)
    line = rng.uniform(size=(400, 1)) @ np.ones((1, 3))
    still = np.repeat(line[:1], 300, axis=0)
    with_rest = estimate_intrinsic_dimension(np.concatenate((line, still)), frames=700, neighbours=15, seed=0)
    assert with_rest == pytest.approx(1.0, abs=0.15)
