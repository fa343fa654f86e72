"""Inputs on another clock, and inputs that answer the motion."""

import numpy as np
import pytest

from lagsplat.diagnose.data_quality.input_checks import (
    check_feedback,
    check_time_offset,
    measure_feedback,
    score_input_shifts,
)
from lagsplat.io.trajectory.trajectory import Trajectory
from tests.unit.diagnose.motions import PERIOD_S, multisine, swing

SLOW = 2.0 * np.pi * np.arange(1200) / 60.0
STEPS = np.sign(np.sin(SLOW / 4.1) + np.sin(SLOW / 1.7 + 1.0))


def shifted(drive: np.ndarray, late_s: float, noise: float) -> Trajectory:
    motion = swing(drive=drive, seconds=20.0, noise=noise, start=(0.0,))
    told = np.interp(motion.time_s + late_s, motion.time_s, motion.u[:, 0])
    return Trajectory(time_s=motion.time_s, q=motion.q, u=told[:, None])


@pytest.mark.parametrize("noise", [0.0, 0.03])
@pytest.mark.parametrize("drive", [STEPS, multisine(1200)], ids=["steps", "multisine"])
@pytest.mark.parametrize("late_s", [-1.4, -0.8, 0.0, 0.15, 0.9, 2.2])
def test_a_gross_offset_of_the_clocks_is_found_and_a_delay_is_none(
    drive: np.ndarray, late_s: float, noise: float
) -> None:
    motion = shifted(drive, late_s, noise)
    shifts, shares = score_input_shifts(motion, period_s=PERIOD_S)
    assert shifts[np.argmax(shares)] == pytest.approx(late_s, abs=PERIOD_S / 16)
    found = check_time_offset([motion], period_s=PERIOD_S)
    gross = abs(late_s) > 0.5 * PERIOD_S
    assert [finding.level for finding in found] == (["undetermined"] if gross else [])


def test_what_cannot_be_shifted_is_not_asked() -> None:
    assert check_time_offset([swing()], period_s=PERIOD_S) == []
    assert check_time_offset([shifted(STEPS, 0.9, 0.0)], period_s=None) == []
    brief = shifted(STEPS, 0.9, 0.0).pieces([(0, 100)])
    assert check_time_offset([brief], period_s=PERIOD_S) == []


def controlled(
    reference: np.ndarray,
    *,
    stiffness: float,
    noise: float,
    rate: float = 0.05,
    kicks: np.ndarray | None = None,
) -> Trajectory:
    """A swing under ``u = reference - stiffness * measured - rate * v``, sampled and held."""
    rng = np.random.default_rng(0)
    w, q, v, rows = 2.0 * np.pi / PERIOD_S, 0.3, 0.0, []
    for k, wanted in enumerate(reference):
        v += 0.0 if kicks is None else kicks[k]
        seen = q + noise * rng.normal()
        u = wanted - stiffness * seen - (rate * v if stiffness else 0.0)
        rows.append((seen, u))
        for _ in range(10):
            v += (-w * w * q - 0.6 * v + 20.0 * u) / 600.0
            q += v / 600.0
    table = np.array(rows)
    return Trajectory(time_s=np.arange(len(table)) / 60.0, q=table[:, :1], u=table[:, 1:])


@pytest.mark.parametrize("noise", [0.003, 0.02])
@pytest.mark.parametrize("reference", [STEPS, multisine(1200)], ids=["steps", "multisine"])
def test_a_controller_passes_on_the_noise_of_its_sensor(reference: np.ndarray, noise: float) -> None:
    looped = controlled(reference, stiffness=1.0, noise=noise)
    assert measure_feedback(looped, channel=0, period_s=PERIOD_S).error_share > 0.1
    assert [found.check for found in check_feedback([looped], period_s=PERIOD_S)] == ["closed_loop"]
    free = controlled(reference, stiffness=0.0, noise=noise)
    assert check_feedback([free], period_s=PERIOD_S) == []


def test_noise_of_the_input_itself_is_no_feedback() -> None:
    free = controlled(STEPS, stiffness=0.0, noise=0.01)
    noisy = free.u + 0.05 * np.random.default_rng(7).normal(size=free.u.shape)
    assert check_feedback([Trajectory(time_s=free.time_s, q=free.q, u=noisy)], period_s=PERIOD_S) == []


def test_without_noise_a_law_of_position_and_rate_gives_it_away() -> None:
    """Kicks and strong damping make the loop broad in frequency; slow or harmonic motion tells nothing."""
    kicks = np.zeros(1200)
    kicks[::150] = np.random.default_rng(0).normal(size=8)
    looped = controlled(np.zeros(1200), stiffness=1.0, noise=0.0, rate=0.3, kicks=kicks)
    assert measure_feedback(looped, channel=0, period_s=PERIOD_S).static_share > 0.95
    assert [found.check for found in check_feedback([looped], period_s=PERIOD_S)] == ["closed_loop"]
    time = np.arange(1200) / 60.0
    for drive in (np.sin(2.0 * np.pi * time / 3.0), np.sin(0.3 * time) + 0.5 * np.sin(0.5 * time + 1.0)):
        driven = controlled(drive, stiffness=0.0, noise=0.0)
        assert check_feedback([driven], period_s=PERIOD_S) == []


def test_too_little_is_not_judged() -> None:
    short = controlled(STEPS[:50], stiffness=1.0, noise=0.01)
    assert np.isnan(measure_feedback(short, channel=0, period_s=PERIOD_S).error_share)
    assert check_feedback([short], period_s=PERIOD_S) == []
