"""Repeated, rounded, clipped and sparse samples, short recordings, and averages of dense ones."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from lagsplat.config.compose import compose
from lagsplat.diagnose.core.result import Finding
from lagsplat.diagnose.data_quality.natural_period import estimate_natural_period_s
from lagsplat.diagnose.data_quality.noise import MeasurementNoise, measure_noise
from lagsplat.diagnose.data_quality.sampling import (
    REPEATED_SAMPLES_CHECK,
    average_dense_samples,
    average_samples,
    check_length,
    check_samples,
    check_slowness,
    count_blocks,
)
from lagsplat.io.trajectory.trajectory import Trajectory
from lagsplat.pipelines.diagnosis_inputs import open_diagnosis_inputs
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


@pytest.mark.parametrize("rate_hz", [60.0, 2000.0])
def test_milliseconds_are_not_taken_for_seconds_in_silence(rate_hz: float) -> None:
    motion = swing(noise=0.01, rate_hz=rate_hz)
    slow = replace(motion, time_s=1000.0 * motion.time_s)
    noise = measure_noise([slow], period_s=1000.0 * PERIOD_S)
    (found,) = check_samples(slow, period_s=1000.0 * PERIOD_S, noise=noise)
    assert found.level == "warn"
    assert "milliseconds" in found.remedy


def test_samples_that_repeat_while_the_motion_goes_on() -> None:
    motion = swing(noise=0.003)
    q = motion.q.copy()
    q[[100, 300]] = q[[99, 299]]
    assert of_samples(replace(motion, q=q)) == ["repeated samples"]
    q = swing(noise=0.0).q.copy()
    q[-200:] = q[-200]  # at rest, where a repeat is no loss
    assert of_samples(replace(motion, q=q)) == []


@pytest.mark.parametrize("rate_hz", [30.0, 100.0, 1000.0])
@pytest.mark.parametrize("step", [0.01, 0.001, 0.0001])
def test_counts_that_repeat_are_no_lost_samples(rate_hz: float, step: float) -> None:
    motion = swing(noise=0.0, rate_hz=rate_hz)
    assert of_samples(replace(motion, q=np.rint(motion.q / step) * step)) == []


@pytest.mark.parametrize(("size", "share"), [(0.05, 1.0), (20.0, 5.0**-0.5)])
def test_means_of_counts_are_no_better_where_the_motion_stays_within_one(size: float, share: float) -> None:
    """The noise is that of the counts, 1 / sqrt(12), unless each sample is another count."""
    motion = swing(noise=0.0, rate_hz=1000.0, start=(size * 60.0,))
    counted = average_samples(replace(motion, q=np.rint(motion.q)), 5, held=False)
    sigma = measure_noise([counted], period_s=PERIOD_S).sigma[0]
    assert sigma == pytest.approx(share / np.sqrt(12.0), rel=0.1)


@pytest.mark.parametrize(("input_s", "told"), [(1.5, []), (12.0, ["quasi-static"])])
def test_a_motion_far_below_the_natural_frequency_is_quasi_static(input_s: float, told: list[str]) -> None:
    drive = np.sin(2.0 * np.pi * np.arange(3600) / 60.0 / input_s)
    motion = swing(seconds=60.0, damping=0.3, start=(0.0,), drive=drive)
    assert [finding.check for finding in check_slowness([motion], period_s=PERIOD_S)] == told
    assert check_slowness([motion], period_s=None) == []


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


def dense_swing(rate_hz: float, *, hertz: float = 1.0, seconds: float = 8.0) -> Trajectory:
    """A swing whose input is its own coordinate."""
    time_s = np.arange(round(seconds * rate_hz)) / rate_hz
    q = np.sin(2.0 * np.pi * hertz * time_s)[:, None]
    return Trajectory(
        time_s=time_s, q=q, u=q, v=2.0 * np.pi * hertz * np.cos(2.0 * np.pi * hertz * time_s)[:, None]
    )


def test_a_fine_log_keeps_its_motion_and_loses_its_samples() -> None:
    (short,), (note,) = average_dense_samples([dense_swing(1000.0)], hold="linear")
    assert 1.0 / short.dt_s == pytest.approx(50.0)
    assert note.level == "note"
    for name, size in (("q", 1.0), ("u", 1.0), ("v", 2.0 * np.pi)):
        phase = 2.0 * np.pi * short.time_s
        there = size * (np.cos if name == "v" else np.sin)(phase)
        # straight lines between inputs have the mean of the input, so that their corners lie beyond it
        beyond = 1.0 + (2.0 * np.pi / 50.0) ** 2 / 12.0 if name == "u" else 1.0
        np.testing.assert_allclose(getattr(short, name)[:, 0], beyond * there, atol=2e-5 * size)


@pytest.mark.parametrize(("rate_hz", "hertz"), [(60.0, 0.1), (99.0, 0.5), (390.0, 5.0)])
def test_what_is_no_finer_than_its_motion_needs_is_left_alone(rate_hz: float, hertz: float) -> None:
    one = dense_swing(rate_hz, hertz=hertz)
    assert average_dense_samples([one], hold="linear") == ((one,), ())


@pytest.mark.parametrize("n", [4, 5])
def test_an_input_that_is_held_acts_between_the_samples_that_are_left(n: int) -> None:
    time_s = np.arange(40) / 1000.0
    step = (time_s >= 0.0195).astype(float)[:, None]
    short = average_samples(Trajectory(time_s=time_s, q=step, u=step), n, held=True)
    edges = np.append(short.time_s, short.time_s[-1] + n / 1000.0)
    pushed_s = float((short.u[:, 0] * np.diff(edges)).sum())
    assert pushed_s == pytest.approx(edges[-1] - 0.020, abs=1e-9)


@pytest.mark.parametrize("n", [2, 5])
@pytest.mark.parametrize("at", range(4))
def test_a_jump_of_an_input_pushes_as_much_as_it_did(n: int, at: int) -> None:
    time_s = np.arange(60) / 1000.0
    jump = (np.arange(60) >= 30 + at).astype(float)
    short = average_samples(Trajectory(time_s=time_s, q=jump[:, None], u=jump[:, None]), n, held=False)
    inside = (time_s >= short.time_s[0]) & (time_s <= short.time_s[-1])
    pushed = np.trapezoid(jump[inside], time_s[inside])
    assert np.trapezoid(short.u[:, 0], short.time_s) == pytest.approx(pushed, abs=6e-4)
    assert short.input_log is not None
    assert short.input_log.u.max() == 1.0


def test_means_of_a_log_with_missing_rows_are_where_the_motion_was() -> None:
    rng = np.random.default_rng(0)
    time_s = np.flatnonzero(rng.uniform(size=4000) > 0.05) / 1000.0
    q = np.sin(6.0 * time_s)[:, None]
    short = average_samples(Trajectory(time_s=time_s, q=q, u=q), 8, held=False)
    np.testing.assert_allclose(short.q[:, 0], np.sin(6.0 * short.time_s), atol=2e-5)


def test_an_input_keeps_its_corners() -> None:
    time_s = np.arange(70) / 1000.0
    ramps = np.abs(time_s - time_s[37])[:, None]
    short = average_samples(Trajectory(time_s=time_s, q=ramps, u=ramps), 5, held=False)
    np.testing.assert_allclose(short.u[:, 0], np.abs(short.time_s - time_s[37]), atol=3e-4)  # mean: 1.2e-3


def test_a_mean_never_reaches_across_a_cut() -> None:
    one = Trajectory(
        time_s=np.arange(31) * 0.01,
        q=np.repeat([0.0, 1.0], [15, 16])[:, None],
        u=np.zeros((31, 0)),
        segments=((0, 15), (15, 31)),
    )
    short = average_samples(one, 5, held=False)
    assert short.segments == ((0, 3), (3, 6))
    np.testing.assert_array_equal(short.q[:, 0], [0, 0, 0, 1, 1, 1])


@pytest.mark.parametrize(("rate_hz", "told"), [(1000.0, {"averaged"}), (100.0, {REPEATED_SAMPLES_CHECK})])
def test_a_sample_that_repeats_is_no_matter_where_many_are_averaged(
    tmp_path: Path, rate_hz: float, told: set[str]
) -> None:
    one = dense_swing(rate_hz, seconds=20.0)
    q = one.q[:, 0].copy()
    q[round(5.0 * rate_hz)] = q[round(5.0 * rate_hz) - 1]
    pd.DataFrame({"t": one.time_s, "q0": q}).to_csv(tmp_path / "log.csv", index=False)
    (tmp_path / "arm.py").write_text("def sim(q, v, u):\n    return -39.5 * q\n", encoding="utf-8")
    pair = open_diagnosis_inputs(f"{tmp_path}/arm.py:sim", f"{tmp_path}/log.csv", compose().diagnose)
    assert {one.check for one in pair.checked.findings} & {"averaged", REPEATED_SAMPLES_CHECK} == told
