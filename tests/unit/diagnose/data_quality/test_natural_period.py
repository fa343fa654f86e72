"""The natural period: of what swings freely, is driven, drifts, is noisy, damped or sampled unevenly."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lagsplat.diagnose.data_quality.natural_period import (
    estimate_natural_period_s,
)
from lagsplat.io.trajectory.trajectory import Trajectory
from tests.unit.diagnose.motions import PERIOD_S, multisine, swing

TIME = np.arange(900) / 60.0


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.1])
@pytest.mark.parametrize(
    ("damping", "seconds"), [(0.0, 15.0), (0.03, 15.0), (0.03, 2.5), (0.3, 4.0)], ids=str
)
def test_a_decay_shows_its_undamped_period(damping: float, seconds: float, noise: float) -> None:
    motion = swing(damping=damping, seconds=seconds, noise=noise)
    assert estimate_natural_period_s([motion]) == pytest.approx(PERIOD_S, rel=0.02 + 0.4 * noise)


@pytest.mark.parametrize("noise", [0.0, 0.03])
@pytest.mark.parametrize(
    "drive",
    [
        np.sin(2.0 * np.pi * TIME / 0.44),
        np.sin(2.0 * np.pi * TIME / 3.3),
        multisine(900),
        np.sign(np.sin(2.0 * np.pi * TIME / 4.1)),
    ],
    ids=["fast sine", "slow sine", "multisine", "steps"],
)
def test_a_driven_motion_shows_the_mechanism_and_not_the_driver(drive: np.ndarray, noise: float) -> None:
    motion = swing(drive=drive, start=(0.0,), noise=noise, damping=0.05)
    assert estimate_natural_period_s([motion]) == pytest.approx(PERIOD_S, rel=0.03)


def test_drift_uneven_times_coarse_and_fine_sampling() -> None:
    motion = swing()
    drifting = replace(motion, q=motion.q + 0.2 * motion.time_s[:, None])
    assert estimate_natural_period_s([drifting]) == pytest.approx(PERIOD_S, rel=0.02)
    kept = np.flatnonzero(np.random.default_rng(1).random(motion.n) < 0.5)
    uneven = replace(
        motion, time_s=motion.time_s[kept], q=motion.q[kept], u=motion.u[kept], segments=((0, len(kept)),)
    )
    assert estimate_natural_period_s([uneven]) == pytest.approx(PERIOD_S, rel=0.02)
    assert estimate_natural_period_s([swing(rate_hz=8.0 / PERIOD_S, seconds=40.0)]) == pytest.approx(
        PERIOD_S, rel=0.02
    )
    assert estimate_natural_period_s([swing(rate_hz=1000.0)]) == pytest.approx(PERIOD_S, rel=0.02)


def test_the_slowest_mode_counts_however_the_modes_are_mixed() -> None:
    motion = swing(start=(1.0, 0.5), noise=0.003)
    mixed = replace(motion, q=motion.q @ np.array([[1.0, 0.4], [-0.7, 2.0]]))
    for seen in (motion, mixed):
        assert estimate_natural_period_s([seen]) == pytest.approx(PERIOD_S, rel=0.03)


def test_releases_of_several_sizes_are_one_mechanism() -> None:
    several = [swing(seconds=4.0, start=(size,), seed=seed) for seed, size in enumerate((1.0, -0.4, 0.2))]
    assert estimate_natural_period_s(several) == pytest.approx(PERIOD_S, rel=0.02)


def test_over_the_top_the_time_between_turning_points_counts() -> None:
    """Swings, then whole turns at rising speed: no linear law holds for both."""
    angle = np.where(TIME < 9.0, np.sin(2.0 * np.pi * TIME / 1.5), 2.5 * (TIME - 9.0) ** 2)
    motion = Trajectory(time_s=TIME, q=angle[:, None], u=np.zeros((900, 0)))
    assert estimate_natural_period_s([motion.pieces([(0, 540)])]) == pytest.approx(1.5, rel=0.02)
    assert estimate_natural_period_s([motion]) == pytest.approx(1.5, rel=0.4)


def test_one_long_test_function_fits_any_law_and_is_not_believed() -> None:
    """Releases much shorter than the whole, with a constant of their own each."""
    several = [
        swing(seconds=3.0 + k, start=(1.0, 0.6), seed=k, damping=0.02 + 0.02 * k, noise=0.01)
        for k in range(3)
    ]
    assert estimate_natural_period_s(several) == pytest.approx(PERIOD_S, rel=0.05)


def test_what_does_not_move_has_none() -> None:
    still = Trajectory(time_s=TIME, q=np.full((900, 1), 3.0), u=np.zeros((900, 0)))
    assert estimate_natural_period_s([still]) is None
    brief = Trajectory(time_s=TIME[:5], q=np.arange(5.0)[:, None], u=np.zeros((5, 0)))
    assert estimate_natural_period_s([brief]) is None


@settings(max_examples=20, deadline=None)
@given(
    scale=st.floats(1e-3, 1e3),
    shift=st.floats(-5.0, 5.0),
    later=st.floats(-1e3, 1e3),
    stretch=st.floats(0.1, 10.0),
)
def test_units_and_zeros_do_not_matter(scale: float, shift: float, later: float, stretch: float) -> None:
    motion = swing(seconds=6.0, drive=multisine(360))
    other = replace(
        motion, q=shift + scale * motion.q, u=scale * motion.u - shift, time_s=later + stretch * motion.time_s
    )
    expected = estimate_natural_period_s([motion])
    assert expected is not None
    assert estimate_natural_period_s([other]) == pytest.approx(stretch * expected, rel=1e-3)
