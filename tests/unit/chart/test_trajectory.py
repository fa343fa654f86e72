import numpy as np
import pytest

from lagsplat.chart.trajectory import EncodedTrajectory


def line(n: int, segments: tuple[tuple[int, int], ...]) -> EncodedTrajectory:
    return EncodedTrajectory(
        np.arange(n, dtype=float)[:, None], np.zeros((n, 0)), 0.02 * np.arange(n), segments
    )


def test_part_cuts_the_segments_and_counts_from_zero() -> None:
    part = line(100, ((0, 30), (30, 70), (70, 100))).part(20, 75)
    assert part.segments == ((0, 10), (10, 50), (50, 55))
    assert part.latents[0, 0] == 20.0
    assert part.dt_s == pytest.approx(0.02)


def test_segments_are_checked() -> None:
    with pytest.raises(ValueError, match=r"segment \(0, 9\)"):
        line(5, ((0, 9),))


def test_inputs_of_one_sign_stay_so_when_smoothed_and_latents_may_swing_over() -> None:
    step = (np.arange(60) >= 30).astype(float)[:, None]
    found = EncodedTrajectory(step, step, 0.02 * np.arange(60), ((0, 60),)).smoothed(2.0)
    assert found.inputs.min() == 0.0
    assert found.inputs.max() == 1.0
    assert found.latents.min() < 0.0
