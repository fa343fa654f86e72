"""What is learned of a motion does not depend on when it was looked at."""

import math
from dataclasses import replace

import numpy as np
import pytest

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.stage2.config import (
    FloorConfig,
    LikelihoodConfig,
    SelectConfig,
    Stage2Config,
    StartConfig,
)
from lagsplat.stage2.fit import fit_dynamics
from tests.stage2_problems import form

DT_S, FREQUENCY_HZ, DECAY_PER_S = 1 / 60, 1.0, 0.5


def ringing(time_s: np.ndarray) -> EncodedTrajectory:
    """A damped oscillation, twice released."""
    half = len(time_s) // 2
    phase = np.concatenate([time_s[:half], time_s[half:] - time_s[half]])
    q = np.exp(-DECAY_PER_S * phase) * np.cos(2 * np.pi * FREQUENCY_HZ * phase)
    return EncodedTrajectory(q[:, None], np.zeros((len(q), 0)), time_s, ((0, half), (half, len(q))))


def learned(trajectory: EncodedTrajectory) -> tuple[float, float]:
    config = Stage2Config(
        form=form(terms="polynomial", potential_degree=2, input_degree=1, matrix_degree=0),
        floor=FloorConfig(1e-2, 1e-4, 1e-2),
        start=StartConfig("likelihood", 100, "data", 0.2, 1.0),
        stride_frames=1,
        integrator="runge_kutta",
        longest_step=math.inf,
        effort=1.0,
        ridge=1.0,
        velocity_weight=1.0,
        steps=0,
        batch=16,
        lr=1e-3,
        final_fraction=0.1,
        gradient_clip=10.0,
        select=SelectConfig(8, 1.0, 2),
        likelihood=LikelihoodConfig(600, 8, 1.3, 4),
    )
    _, report = fit_dynamics(trajectory, np.eye(1), config, 0, rest=np.zeros(1))
    assert report.at_rest is not None
    return report.at_rest.frequency_hz[0], report.at_rest.decay_per_s[0]


@pytest.fixture(scope="module")
def clock() -> np.ndarray:
    rng = np.random.default_rng(0)
    frames = np.arange(800) + rng.uniform(-0.2, 0.2, 800)
    return DT_S * frames[rng.uniform(size=800) > 0.05]


def test_frequency_and_decay_do_not_depend_on_the_clock(clock: np.ndarray) -> None:
    even, uneven = (learned(ringing(time_s)) for time_s in (DT_S * np.arange(800), clock))
    assert even == pytest.approx((FREQUENCY_HZ, DECAY_PER_S), rel=0.005)
    assert uneven == pytest.approx(even, rel=0.005)


def test_taking_the_clock_for_even_would_show(clock: np.ndarray) -> None:
    seen = ringing(clock)
    mistaken = learned(replace(seen, time_s=seen.dt_s * np.arange(len(clock))))
    assert abs(mistaken[0] / FREQUENCY_HZ - 1) > 0.02
    assert abs(mistaken[1] / DECAY_PER_S - 1) > 0.02
