"""Repeated, rounded, clipped and sparse samples; recordings that are short or at rest."""

from dataclasses import replace

import numpy as np
import pytest

from lagsplat.diagnose.core.result import Finding
from lagsplat.diagnose.data_quality.natural_period import estimate_natural_period_s
from lagsplat.diagnose.data_quality.noise import MeasurementNoise, measure_noise
from lagsplat.diagnose.data_quality.sampling import check_length, check_samples, count_blocks
from lagsplat.io.trajectory.trajectory import Trajectory
from tests.unit.diagnose.motions import PERIOD_S, swing


def of_samples(motion: Trajectory) -> list[str]:
    noise = measure_noise([motion], period_s=PERIOD_S)
    return [finding.check for finding in check_samples(motion, period_s=PERIOD_S, noise=noise)]


def of_length(*motions: Trajectory) -> list[Finding]:
    period_s = estimate_natural_period_s(motions)
    noise = measure_noise(motions, period_s=period_s)
    return check_length(motions, period_s=period_s, noise=noise, side="real")


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.1])
def test_a_good_recording_has_nothing_to_say(noise: float) -> None:
    assert of_samples(swing(noise=noise)) == []
    assert of_length(swing(noise=noise, seconds=18.0)) == []


def test_samples_that_repeat_while_the_motion_goes_on() -> None:
    motion = swing(noise=0.003)
    q = motion.q.copy()
    q[[100, 300]] = q[[99, 299]]
    assert of_samples(replace(motion, q=q)) == ["repeated samples"]
    q = swing(noise=0.0).q.copy()
    q[-200:] = q[-200]  # at rest, where a repeat is no loss
    assert of_samples(replace(motion, q=q)) == []


def test_steps_count_only_when_they_are_coarse() -> None:
    motion = swing(noise=0.0)
    size = float(motion.q.std())
    coarse, fine = (replace(motion, q=np.rint(motion.q / step) * step) for step in (0.2 * size, 0.01 * size))
    assert "quantised" in of_samples(coarse)
    assert "clipped" not in of_samples(coarse)
    assert of_samples(fine) == []


def test_a_sensor_at_its_limit() -> None:
    motion = swing(damping=0.003)
    assert of_samples(replace(motion, q=np.minimum(motion.q, 0.7 * motion.q.max()))) == ["clipped"]


@pytest.mark.parametrize(("per_period", "expected"), [(10.0, []), (6.0, ["warn"]), (3.0, ["undetermined"])])
def test_samples_a_period(per_period: float, expected: list[str]) -> None:
    motion = swing(rate_hz=per_period / PERIOD_S, seconds=40.0)
    noise = MeasurementNoise(np.zeros(1), np.zeros(1), np.zeros(1))
    assert [found.level for found in check_samples(motion, period_s=PERIOD_S, noise=noise)] == expected


@pytest.mark.parametrize(
    ("seconds", "expected"),
    [(2.0, ("undetermined", "too short")), (5.0, ("warn", "short")), (18.0, None)],
)
def test_how_long_is_long_enough(seconds: float, expected: tuple[str, str] | None) -> None:
    found = of_length(swing(seconds=seconds))
    assert [(finding.level, finding.check) for finding in found] == ([expected] if expected else [])


def test_blocks_are_counted_clip_by_clip() -> None:
    motion = swing(seconds=16.5)
    assert count_blocks([motion], period_s=PERIOD_S) == 10
    assert count_blocks([motion, motion], period_s=PERIOD_S) == 20
    shreds = motion.cut(range(0, motion.n, 90))
    assert count_blocks([shreds], period_s=PERIOD_S) == 0
    assert count_blocks([shreds], period_s=0.1) == 11  # no block is shorter than sixty samples


def test_a_mechanism_at_rest_shows_nothing() -> None:
    motion = swing()
    noise = np.random.default_rng(0).normal(size=motion.q.shape)
    for q in (noise, 5.0 + 1e-3 * noise, np.zeros_like(noise)):
        found = of_length(replace(motion, q=q))
        assert [(finding.level, finding.check) for finding in found] == [("undetermined", "at rest")]


def test_one_coordinate_at_rest_is_named() -> None:
    motion = swing(start=(1.0, 0.5), seconds=18.0)
    still = motion.q.copy()
    still[:, 1] = 1e-3 * np.random.default_rng(0).normal(size=motion.n)
    found = of_length(replace(motion, q=still))
    assert [(finding.level, finding.columns) for finding in found] == [("warn", ("q1",))]
